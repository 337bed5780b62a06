"""Conclusions on pages follow from numbers: of the same page, or of a validation case."""

import json
import re
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

from experiments.benchmarks.accuracy import extrapolate

DOCS = Path(__file__).parents[2] / "docs"
NUMBER = r"[+−-]?\d+(?:\.\d+)?"
STREAM, RESOLUTION, BODY = "tutorials/fish_in_a_stream.md", "resolution.md", "tutorials/own_body.md"

Numbers = Sequence[float]


def read(page: str) -> str:
    return " ".join((DOCS / page).read_text(encoding="utf-8").split())


def find(page: str, words: str) -> list[str]:
    """Return the numbers ``#`` of a passage that a page must have."""
    pattern = re.escape(words).replace(r"\#", f"({NUMBER})").replace(r"\ ", " ")
    match = re.search(pattern, read(page))
    assert match, f"{page}: no longer says: {words}"
    return [number.replace("−", "-") for number in match.groups()]


def measured(case: str, quantity: str, resolution: str | None = None) -> float:
    """Return a result of a validation case, by default on its finest grid."""
    checks = json.loads((DOCS / "validation" / f"{case}.json").read_text(encoding="utf-8"))
    (found,) = [one for one in checks["checks"] if one["quantity"] == quantity]
    return float(found["ours"] if resolution is None else found["refinement"][resolution])


def swum() -> dict[str, float]:
    """Return the speed of a fish with an immersed boundary by its length."""
    checks = json.loads((DOCS / "validation/swimmer.json").read_text(encoding="utf-8"))["checks"]
    found: dict[str, float] = checks[0]["refinement"]
    return found


def off(value: float, reference: float) -> float:
    """Return a deviation in percent."""
    return 100.0 * (value / reference - 1.0)


#: Page, what it concludes, and the numbers that it should name.
NAMED: list[tuple[str, str, Callable[[], Numbers]]] = [
    (
        RESOLUTION,
        "#, #, #, # and # % below the limit",
        lambda: [
            -off(speed, extrapolate(*list(swum().values())[-3:])) for speed in swum().values()
        ],
    ),
    (
        RESOLUTION,
        "speed at L = 100 by # %, mean drag at D = 20 by # % and lift amplitude by # %",
        lambda: [
            off(measured("compressibility", f"{what}: default speed / half of it"), 1.0)
            for what in (
                "swimming speed, L = 100",
                "mean drag of the cylinder",
                "lift of the cylinder",
            )
        ],
    ),
    (
        RESOLUTION,
        "lift amplitude # % low",
        lambda: [
            -off(
                measured("channel-cylinder", "C_l,max, Re = 100", "D = 20"),
                measured("channel-cylinder", "C_l,max, Re = 100"),
            )
        ],
    ),
    (
        BODY,
        "the two drags differ by # %",
        lambda: [off(*map(float, find(BODY, "drag #, lift 0.446; immersed boundary #")))],
    ),
    (STREAM, "= # N per metre of depth", lambda: [1000 * 0.04**3 * 3**2]),
]


@pytest.mark.parametrize(("page", "words", "compute"), NAMED, ids=[words for _, words, _ in NAMED])
def test_numbers_of_a_conclusion_follow_from_others(
    page: str, words: str, compute: Callable[[], Numbers]
) -> None:
    said = find(page, words)
    for text, value in zip(said, compute(), strict=True):
        digits = len(text.partition(".")[2])
        assert abs(value - float(text)) <= 0.5 * 10.0**-digits + 1e-9, f"{words}: {value}"


def forces(words: str) -> tuple[float, float]:
    along, across = map(float, find(STREAM, words))
    return along, across


PRINTED = (
    "anguilliform: mean force along the stream # ρ L³/T² "
    "carangiform: mean force along the stream # ρ L³/T²"
)

#: Page, what it concludes, and whether its numbers say so.
HELD: list[tuple[str, str, Callable[[], bool]]] = [
    (
        STREAM,
        "Released, the anguilliform fish would swim upstream, the carangiform one, whose tail moves"
        " less, drift downstream.",
        lambda: forces(PRINTED)[0] < 0.0 < forces(PRINTED)[1],
    ),
    (
        STREAM,
        "The immersed boundary keeps the order but not the sign",
        lambda: 0.0 < forces("not the sign: # and #")[0] < forces("not the sign: # and #")[1],
    ),
    (
        RESOLUTION,
        "Resolve an obstacle by 20 nodes (drag within 1 %",
        lambda: all(
            abs(off(measured("channel-cylinder", f"C_d{of}", "D = 20"), reference)) < 1.0
            for of, reference in ((", Re = 20", 5.5795), (",max, Re = 100", 3.23))
        ),
    ),
    (
        BODY,
        "20 nodes across the body give the drag within 1 %",
        lambda: abs(off(measured("channel-cylinder", "C_d, Re = 20", "D = 20"), 5.5795)) < 1.0,
    ),
]


@pytest.mark.parametrize(("page", "words", "holds"), HELD, ids=[words for _, words, _ in HELD])
def test_conclusion_holds_for_its_numbers(page: str, words: str, holds: Callable[[], bool]) -> None:
    assert not find(page, words)
    assert holds()
