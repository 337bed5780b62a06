"""Search for the best C-start by CMA-ES: ``python -m experiments.c_start folder=runs/c_start``.

Eight numbers are searched: bend and wave at three points of the body, tau and phi of the two
strokes of ``fishrl.physics.C_START``, beginning there; the durations stay. The goal is the distance
of the centre of mass after 2.7 T, less a penalty for each part of the muscles' work beyond that of
the published strokes on the same grid. The candidates of a generation swim in one batch of flows.
``c_start.json`` in the folder keeps every candidate: the same command goes on where it ended, also
with more generations, as long as the code is the same. In the end the best one and the published
one swim on finer grids, and ``c_start.png`` shows them.
"""

from __future__ import annotations

import json
import logging
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from math import isnan, nan, pi
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

try:
    import cmaes
except ImportError:  # it comes with the extra `sweep`
    cmaes = None  # type: ignore[assignment]

from experiments.figures.style import panels, tidy
from experiments.pages import write_table
from experiments.program import program
from experiments.validation.c_start import draw_picture, run_strokes, take_picture
from fishrl.bounds import Checked, bounded
from fishrl.extras import show_install
from fishrl.physics import C_START, Stroke, Strokes
from fishrl.physics.cache_key import hash_sources
from fishrl.training.run_folder import RunFolder, write_json

logger = logging.getLogger(__name__)

#: Bounds of bend, wave, tau and phi; curvatures within a full circle, as in CubismUP 2D.
LOW = np.array([-2.0 * pi] * 6 + [0.0, 0.0])
HIGH = np.array([0.0] * 6 + [1.0, 2.0 * pi])
#: Loss of distance, L, per relative excess of work: more than any excess was seen to gain.
PENALTY = 2.0
_SOURCES = ("experiments.c_start", "experiments.validation.c_start")


@dataclass(kw_only=True)
class CStartSettings(Checked):
    """Settings of a search for the best C-start.

    Args:
        folder: folder of the results.
        generations: number of generations in all, finished ones included.
        population: candidates in each generation.
        sigma: initial standard deviation, as a share of the distance between the bounds.
        seed: seed of the search.
        body_length: L in nodes.
        inset: inset of the markers, nodes; 0.45 brings coarse grids nearer to fine ones.
        finer: body lengths at which the best candidate is compared with the published strokes.
        workers: processes that share the flows; None is one per core.
        compile: compile the flow step.
    """

    folder: str = "runs/c_start"
    generations: int = bounded(20, least=1)
    population: int = bounded(12, least=4)
    sigma: float = bounded(0.15, greater=0, largest=1)
    seed: int = bounded(0, least=0)
    body_length: int = bounded(48, least=16)
    inset: float = bounded(0.45, least=0, largest=1)
    finer: list[int] = field(default_factory=lambda: [96])
    workers: int | None = None
    compile: bool = True

    @property
    def identity(self) -> dict[str, Any]:
        """What every candidate depends on."""
        free = ("folder", "generations", "finer", "workers", "compile")
        given = {name: value for name, value in asdict(self).items() if name not in free}
        return given | {"code": hash_sources(*_SOURCES), "torch": str(torch.__version__)}


def to_numbers(strokes: Strokes) -> NDArray[np.float64]:
    """Return the eight numbers of a C-start, in parts of the bounds' distance."""
    first = strokes.sequence[0]
    numbers = np.array([*first.bend, *first.wave, first.lag, strokes.phase])
    return np.asarray((numbers - LOW) / (HIGH - LOW), dtype=np.float64)


def to_strokes(numbers: Sequence[float]) -> Strokes:
    """Return the strokes: into a C, and out of it, as long as the published ones."""
    values = [float(v) for v in LOW + np.array(numbers) * (HIGH - LOW)]
    bend, wave = (values[0], values[1], values[2]), (values[3], values[4], values[5])
    ends = zip(C_START.sequence, (bend, (0.0, 0.0, 0.0)), strict=True)
    strokes = (
        Stroke(duration=old.duration, bend=new, wave=wave, lag=values[6]) for old, new in ends
    )
    return Strokes(sequence=tuple(strokes), phase=values[7])


class Search:
    """A search and what it has found, kept in ``c_start.json``."""

    def __init__(self, settings: CStartSettings) -> None:
        self.settings, self.file = settings, Path(settings.folder) / "c_start.json"
        self.swim = partial(
            run_strokes,
            inset=settings.inset,
            num_workers=settings.workers,
            compile=settings.compile,
        )
        self.found: dict[str, Any] = {"settings": settings.identity, "generations": []}
        if self.file.exists():
            self.found = json.loads(self.file.read_text(encoding="utf-8"))
            if self.found["settings"] != settings.identity:
                raise ValueError(
                    f"{self.file}: holds another search, {self.found['settings']}; give another "
                    "folder"
                )

    def run(self) -> None:
        """Search until there are as many generations as wanted."""
        given, length = self.settings, self.settings.body_length
        if "published" not in self.found:
            (self.found["published"],), _ = self.swim([C_START], body_length=length)
            write_json(self.file, self.found)
        optimiser = cmaes.CMA(
            mean=to_numbers(C_START),
            sigma=given.sigma,
            bounds=np.array([[0.0, 1.0]] * len(LOW)),
            seed=given.seed,
            population_size=given.population,
        )
        done = self.found["generations"]
        for number in range(given.generations):
            asked = [optimiser.ask() for _ in range(given.population)]
            if number == len(done):
                results, _ = self.swim([to_strokes(one) for one in asked], body_length=length)
                done.append(
                    {
                        "candidates": [one.tolist() for one in asked],
                        "distance": [one["distance"] for one in results],
                        "work": [one["work"][-1] for one in results],
                        "fine": [one["fine"] for one in results],
                    }
                )
                write_json(self.file, self.found)
            scores = self.rate(done[number])
            kept = [np.array(one) for one in done[number]["candidates"]]
            optimiser.tell(list(zip(kept, [-score for score in scores], strict=True)))
            best = self.find_best(number + 1)
            logger.info("generation %d: best %.3f L, now %.3f L", number, best[0], max(scores))

    def rate(self, generation: dict[str, Any]) -> list[float]:
        """Return the distance less the penalty of each candidate; 1 below all if it diverged."""
        allowed = self.found["published"]["work"][-1]
        scores = [
            distance - PENALTY * max(0.0, work / allowed - 1.0) if is_fine else nan
            for distance, work, is_fine in zip(
                generation["distance"], generation["work"], generation["fine"], strict=True
            )
        ]
        lowest = min((score for score in scores if not isnan(score)), default=0.0)
        return [lowest - 1.0 if isnan(score) else score for score in scores]

    def find_best(self, num_generations: int | None = None) -> tuple[float, list[float]]:
        """Return score and numbers of the best candidate."""
        return max(
            (score, numbers)
            for generation in self.found["generations"][:num_generations]
            for score, numbers in zip(self.rate(generation), generation["candidates"], strict=True)
        )

    def compare(self) -> dict[int, list[dict[str, Any]]]:
        """Return the published and the best strokes' swims at each resolution, with pictures."""
        kept, pairs = self.found.setdefault("compared", {}), {}
        _, best = self.find_best()
        for size in [self.settings.body_length, *self.settings.finer]:
            if kept.get(str(size), {}).get("best") != best:
                swims, solver = self.swim([C_START, to_strokes(best)], body_length=size)
                if not all(one["fine"] for one in swims):
                    raise ValueError(f"at L = {size} a swim diverged; give others in finer")
                pair = [one | take_picture(solver, i, size) for i, one in enumerate(swims)]
                kept[str(size)] = {"best": best, "pair": pair}
                write_json(self.file, self.found)
            pairs[size] = kept[str(size)]["pair"]
        return pairs


def tabulate(pairs: dict[int, list[dict[str, Any]]], best: Sequence[float]) -> str:
    """Return numbers and results of the published and the best strokes, Markdown."""
    rows = []
    for name, numbers in (("published", to_numbers(C_START)), ("best", best)):
        values = LOW + np.array(numbers) * (HIGH - LOW)
        parts = (values[:3], values[3:6], values[6:7], values[7:])
        rows.append([name, *(", ".join(f"{v:.2f}" for v in part) for part in parts)])
    heads = ("strokes", "bend B L at 0.5, 0.75, 0.95 L", "wave K L", "τ", "φ")
    found = [
        [size, name, f"{swim['distance']:.3f}", f"{swim['work'][-1]:.3f}"]
        for size, pair in pairs.items()
        for name, swim in zip(("published", "best"), pair, strict=True)
    ]
    columns = ("L, nodes", "strokes", "distance, L", "work, ρ L⁴ / T²")
    return f"{write_table(heads, rows)}\n{write_table(columns, found)}"


def write_figure(path: Path, search: Search, pair: Sequence[dict[str, Any]], size: int) -> None:
    """Draw the course of the search, and both flows in the end."""
    scores = [search.rate(one) for one in search.found["generations"]]
    with panels(path, size=(11.0, 3.6), columns=3, has_grid=False) as axes:
        course, *pictures = axes[0]
        for number, each in enumerate(scores):
            course.plot([number] * len(each), each, ".", color="0.7")
        course.plot(np.maximum.accumulate([max(each) for each in scores]), label="best so far")
        distance = search.found["published"]["distance"]
        course.axhline(distance, color="black", linestyle="--", label="published strokes")
        course.set(xlabel="generation", ylabel="distance less penalty  [L]")
        course.set_ylim(max(0.0, min(map(min, scores))), None)
        course.legend(loc="lower right")
        tidy(course)
        for place, swim, name in zip(pictures, pair, ("published", "best"), strict=True):
            draw_picture(place, swim)
            place.set_title(f"{name}, L = {size}: {swim['distance']:.2f} L")


@program(CStartSettings)
def main(settings: CStartSettings) -> None:
    """Search, compare and draw."""
    if cmaes is None:
        raise ImportError(f"the search needs cmaes: {show_install('sweep')}")
    folder = Path(settings.folder)
    folder.mkdir(parents=True, exist_ok=True)
    with RunFolder(folder).hold():
        search = Search(settings)
        search.run()
        pairs = search.compare()
        finest = max(pairs)
        write_figure(folder / "c_start.png", search, pairs[finest], finest)
        print(tabulate(pairs, search.find_best()[1]))
        print(f"written to {folder}")


if __name__ == "__main__":
    main()
