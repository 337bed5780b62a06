"""Conclusions on pages follow from numbers: of the page, a validation case, or a study's data.

A conclusion is a sentence with a word of ``CONCLUDING``. Each one on ``PAGES`` has its entry in
``NAMED`` or ``HELD``, or in ``UNSTORED`` if what it rests on is not in the repository.
"""

import re
from collections.abc import Callable
from typing import Any

import pytest

from tests.docs.cells import CELLS, find_cells
from tests.docs.cells import UNSTORED as UNCHECKED
from tests.docs.conclusions import HELD, NAMED
from tests.docs.page_numbers import DOCS, PAGES, RESULTS, Numbers, find, match_words, read


def _list(entries: dict[str, dict[str, Any]]) -> list[Any]:
    """Return page, words and function of each conclusion, named by its words."""
    return [
        pytest.param(page, words, check, id=words)
        for page, conclusions in entries.items()
        for words, check in conclusions.items()
    ]


@pytest.mark.parametrize(("page", "words", "compute"), _list(NAMED))
def test_numbers_in_conclusion_hold(page: str, words: str, compute: Callable[[], Numbers]) -> None:
    check_numbers(find(page, words), compute())


def check_numbers(said: list[str], values: Numbers) -> None:
    """Compare numbers with their values, to as many digits as are said."""
    for text, value in zip(said, values, strict=True):
        digits = len(text.partition(".")[2])
        assert abs(value - float(text)) <= 0.5 * 10.0**-digits + 1e-9, f"{text}: {value}"


@pytest.mark.parametrize("cells", CELLS, ids=" | ".join)
def test_cells_of_a_table_repeat_the_data_of_a_study(cells: tuple[str, ...]) -> None:
    check_numbers(find_cells(*cells), CELLS[cells]())


def test_rows_of_results_are_checked_or_their_data_are_not_stored() -> None:
    text = (DOCS / RESULTS).read_text(encoding="utf-8")
    rows = [
        line for line in text.splitlines() if re.match(r"\|(?! [a-z]+ \| [a-z ]+ \|$).*\d", line)
    ]
    known = [f"| {cells[1]} " for cells in CELLS if cells[0] == RESULTS]
    known += [f"| {start}" for start in UNCHECKED]
    assert len(rows) > 15
    assert not [row for row in rows if not any(row.startswith(start) for start in known)]


@pytest.mark.parametrize(("page", "words", "holds"), _list(HELD))
def test_conclusion_holds_for_its_numbers(page: str, words: str, holds: Callable[[], bool]) -> None:
    assert not find(page, words)
    assert holds()


#: Words of comparisons, and of sizes without a number.
CONCLUDING = re.compile(
    r"\b(nearly|hardly|twice|doubles|halves|better|worse|ahead|longer|shorter|farther|slower|faster"
    r"|smaller|fewer|outlasts|as (?:well|good|long|often|much) as|beats? the|significant(?:ly)?"
    r"|(?:less|more) (?:often|work|power|energy|than|distance)|scatter|chance|never|rarely|always"
    r"|suffice|converged|missed|saves?|saving|prolong|enough)\b"
)
#: Sentences with such a word that say what something is, does, or would be.
STATED = (
    "Halving the speed doubles the cost and halves",
    "3 doubles it again far away",
    "Classifiers always scale their inputs",
    "missed goals and the complete tables",
    "which strokes carry it farther",
    "it may bend by more than 90°",
    "beat the tail harder",
    "A longer distance does not contradict theirs",
    '"never fades" memory 1',
    "Once per tail beat the policy turns",
    "would shear the faster bypass",
    "a third level doubles it once more",
    "Each coarse step fills",
    "segments are shorter than",
    "so none is missed",
    "a midline that bends by more than",
    "couple explicitly",
    "Score on the test",
    "nearly identical, so a random split",
    "A training saves its complete state",
    "tasks in which all actions are always legal",
    "and all are always legal",
    "and scores what it saves",
    "how to search for better settings",
    "start a run with smaller `num_envs`",
    "it is long enough that neither tail nor stream",
    "Fish must never overlap",
    "Unless `save`, `screenshot` or `live` is given",
)
#: Conclusions from measurements whose data the repository does not have.
UNSTORED = (
    "A fish whose midline keeps its length",
    "a fish of 32 nodes was 1 to 2 % faster",
    "`learner_device=cpu` is better",
    "behind the leader none does",
    "It keeps its place with noise or delay on its signals",
    "about 50 times slower",
    "two at a time take about as long as one after the other",
)


def list_sentences(page: str) -> list[str]:
    """Return the sentences of a page outside code, tables and headings."""
    text = (DOCS / page).read_text(encoding="utf-8")
    text = re.sub(r"^```.*?^```$|<!--.*?-->|^[|#].*?$", "\n", text, flags=re.DOTALL | re.MULTILINE)
    paragraphs = [" ".join(part.split()) for part in re.split(r"\n\s*\n|\n(?=[*\d])", text)]
    ends = re.compile(r"(?<=[\w)%*°`]\.) (?=[A-Z*`\[])")
    return [one for paragraph in paragraphs for one in ends.split(paragraph)]


@pytest.mark.parametrize("page", PAGES)
def test_every_conclusion_is_checked(page: str) -> None:
    text = read(page)
    found = [match_words(text, words) for words in (*NAMED.get(page, ()), *HELD.get(page, ()))]
    spans = [match.span() for match in found if match]
    open_ends = []
    for sentence in filter(CONCLUDING.search, list_sentences(page)):
        begin = text.index(sentence)
        is_checked = any(low < begin + len(sentence) and begin < high for low, high in spans)
        if not is_checked and not any(words in sentence for words in (*STATED, *UNSTORED)):
            open_ends.append(sentence)
    assert not open_ends, "tie each to numbers, in NAMED or HELD"


def test_what_needs_no_number_is_still_said() -> None:
    """In the words of these lists, so that they do not hide other sentences."""
    text = " ".join(map(read, PAGES))
    assert not [words for words in (*STATED, *UNSTORED) if words not in text]
