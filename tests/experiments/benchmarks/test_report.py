"""Ratios, goals, figures and page of a benchmark."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from experiments.benchmarks.accuracy import FOLDER, extrapolate, read_errors
from experiments.benchmarks.machine import describe_machine
from experiments.benchmarks.measuring import (
    FISH,
    KERNEL,
    PERIODIC,
    PROBE,
    WALLS,
    Benchmark,
    Results,
)
from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.report import (
    compare_speeds,
    list_goals,
    measure_speed,
    render_results,
    write_pages,
)

ROOT = Path(__file__).parents[3]
NODES = 1_000_000
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def make_case(label: str, speeds: Sequence[float], *, scope: str = WALLS, **rest: Any) -> Benchmark:
    """Return a case with these MLUPS by round."""
    fields = {"group": "solver", "num_nodes": NODES}
    measured = {"seconds": [NODES / speed / 1e6 for speed in speeds]} | rest.pop("measured", {})
    name = f"1 × 1000 × 1000, {label}"
    return Benchmark(label=label, name=name, scope=scope, measured=measured, **fields | rest)


@pytest.fixture
def results() -> Results:
    """Return a run with entries for every table."""
    swim: dict[str, Any] = {"body_length": 100, "period": 562, "flows": 1}
    fish: dict[str, Any] = {"group": "coupled", "scope": FISH, "measured": {"bytes": [44.0]}}
    cases = [
        make_case("probe/copy", [700, 710, 690], scope=PROBE, group="probe"),
        make_case("large/walls", [1000, 1010, 990]),
        make_case("large/fish", [800, 810, 790], facts=swim, **fish),
        make_case("batch2/fish", [700] * 3, facts=swim | {"flows": 2}, **fish),
        make_case("large/kernel", [1200, 1210, 1190], scope=KERNEL),
        make_case("large/periodic", [1100, 1110, 1090], scope=PERIODIC),
        make_case("gpu/copy", [10000] * 3, scope=PROBE, group="gpu"),
        make_case("gpu/fish", [7000] * 3, scope=FISH, group="gpu"),
        make_case("env/policy", [495] * 3, group="env", measured={"outside_flow": [0.01] * 3}),
        make_case("train/gradient", [200] * 3, group="train", num_nodes=0),
    ]
    machine = describe_machine() | {"cpu": "a machine", "cores": 2, "caches": {"L3": 32 * 2**20}}
    return Results(
        machine=machine, settings={"threads": 2, "rounds": 3, "burst": 0.03}, cases=cases
    )


def test_ratios_compare_node_updates_of_the_same_round() -> None:
    ours, theirs = make_case("a", [100, 10, 50, 100]), make_case("b", [50, 5, 25, 50])
    assert compare_speeds(ours, theirs) == pytest.approx((2.0, 2.0, 2.0))  # also in slow rounds
    small = make_case("small", [100, 100], num_nodes=10)
    assert measure_speed(small).median == pytest.approx(1e-3)
    assert compare_speeds(make_case("large", [100, 100]), small).median == pytest.approx(1e5)


def test_goals_are_met_missed_or_left_out(results: Results) -> None:
    lines = {line[0]: line[1:] for line in list_goals(results)}
    fish = lines["GPU, whole step with fish / copy"]
    assert fish == ["≥ 0.75 ×", "0.70 ×", "MISSED"]
    assert "GPU, bulk / copy" not in lines  # not measured
    share = lines["share of an environment step outside the flow, L = 50"]
    assert share == ["≤ 2 %", "1.00 %", "met"]


def test_errors_of_grids_come_from_stored_validation() -> None:
    assert extrapolate(1.0, 1.5, 1.75) == pytest.approx(2.0)  # 1, 1/2 and 1/4 from the limit
    errors = read_errors(ROOT / FOLDER)
    for reynolds in (500, 7142):
        coarse, middle, fine = (errors[length, 1][reynolds] for length in (32, 50, 100))
        assert -0.3 < coarse < middle < fine < 0.0
        assert errors[100, 3][reynolds] == pytest.approx(fine, abs=0.003)


def test_figures_show_available_results(results: Results, tmp_path: Path) -> None:
    files = write_plots(results, tmp_path / "figures")
    assert [file.name for file in files] == ["scaling.png"]
    results.cases = []
    assert write_plots(results, tmp_path) == {}
    assert "###" not in render_results(results)


def test_page_changes_only_between_marks(results: Results, tmp_path: Path) -> None:
    page = tmp_path / "performance.md"
    page.write_text(f"before\n\n{BEGIN}\nlast year\n{END}\n\nafter\n")
    figures = {tmp_path / "figures" / "scaling.png": "Speed"}
    for _ in range(2):  # the second time replaces the first
        write_pages(results, figures, tmp_path)
        text = page.read_text()
        assert text.startswith(f"before\n\n{BEGIN}\na machine, 2 cores")
        assert text.endswith(f"![Speed](figures/scaling.png)\n{END}\n\nafter\n")
        assert "last year" not in text
        assert "| 1 × 1000 × 1000, gpu/fish | with fish | 7000 " in text
