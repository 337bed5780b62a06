"""What the benchmark makes of its times: ratios, goals, tables, figures, the page and the file."""

from collections.abc import Sequence
from pathlib import Path

import pytest
from PIL import Image

from experiments.benchmarks.comparison import FISH, KERNEL, PERIODIC, PROBE, WALLS, Row, Skipped
from experiments.benchmarks.plots import measure_bandwidth, write_plots
from experiments.benchmarks.report import describe_run, list_tables, list_targets, write_page
from experiments.benchmarks.results import Results, Spread, compare, measure_speed, spread

NODES = 1_000_000
BEGIN, END = "<!-- measured: begin -->", "<!-- measured: end -->"


def make_row(
    label: str,
    speeds: Sequence[float],
    *,
    scope: str = WALLS,
    group: str = "solver",
    **rest: object,
) -> Row:
    """Return a row with these MLUPS by round."""
    fields = {
        "code": "fishrl", "name": f"1 × 1000 × 1000, {label}", "num_nodes": NODES,
        "working_set": 36 * NODES, "num_steps": 2,
    }  # fmt: skip
    seconds = [NODES / speed / 1e6 for speed in speeds]
    return Row(label=label, group=group, scope=scope, seconds=seconds, **fields | rest)  # type: ignore[arg-type]


def make_fact(label: str, group: str, **facts: object) -> Row:
    return Row(label=label, group=group, name=label, num_steps=0, facts=facts)


@pytest.fixture
def results() -> Results:
    """Return a run in which everything was measured that there is a table for."""
    lbmpy = {"group": "peers", "code": "lbmpy"}
    swimming = {"body_length": 100, "period": 562, "flows": 1, "bytes": 44.0}
    fish = {"group": "coupled", "scope": FISH}
    rows = [
        make_row("probe/copy", [700, 710, 690], scope=PROBE, group="probe", code="torch"),
        make_row("probe/in place", [1400, 1390, 1410], scope=PROBE, group="probe", code="torch"),
        make_row("large/walls", [1000, 1010, 990]),
        make_row("large/fish", [800, 810, 790], facts=swimming, **fish),
        make_row("batch2/fish", [700] * 3, facts=swimming | {"flows": 2}, **fish),
        make_row("lbmpy/aa, kernel", [1200, 1210, 1190], scope=KERNEL, **lbmpy),
        make_row("lbmpy/esotwist, kernel", [1300, 1310, 1290], scope=KERNEL, **lbmpy),
        make_row("lbmpy/pull", [500, 505, 495], scope=PERIODIC, **lbmpy),
        make_row("gpu/fish", [9000] * 3, scope=FISH, group="gpu"),
        make_row("env/solver", [500, 510, 490], group="env"),
        make_row("env/policy", [495] * 3, group="env", extras={"outside_flow": [0.01] * 3}),
        make_row("train/gradient", [200] * 3, group="train", num_nodes=0),
        make_row("live/with", [200] * 3, group="live", extras={"processor": [0.2] * 3}),
        make_fact("compile/cold", "compile", seconds=30.0),
        make_fact("compile/warm", "compile", seconds=0.5),
        make_fact("collision", "profile", place="flow", seconds=0.6, share=0.6, size="4 × 9"),
        make_fact("policy", "profile", place="TorchRL", seconds=0.4, share=0.4, size="4 × 9"),
    ]  # fmt: skip
    return Results(
        machine={
            "cpu": "a machine", "cores": 2, "torch": "2.13.0", "python": "3.11", "gpu": None,
            "instructions": "AVX512", "caches": {"L3": 32 * 2**20}, "load": 0.1,
            "versions": {"lbmpy": "2.0"},
        },
        settings={"threads": 2, "rounds": 3, "burst": 0.03},
        rows=rows,
        skipped=[Skipped(code="numba", group="peers", why="No module 'numba'", has_failed=False)],
    )  # fmt: skip


def test_a_spread_is_the_median_between_the_quartiles() -> None:
    assert spread([5.0, 1.0, 4.0, 2.0, 3.0]) == Spread(2.0, 3.0, 4.0)
    assert Spread(1.0, 2.0, 3.0).show(1) == "2.0 [1.0, 3.0]"
    assert Spread(1.0, 1.0, 1.0).show() == "1.00"


def test_a_ratio_does_not_feel_a_machine_that_slows_down_for_a_round() -> None:
    ours, theirs = make_row("a", [100, 10, 50, 100]), make_row("b", [50, 5, 25, 50])
    assert compare(ours, theirs) == pytest.approx((2.0, 2.0, 2.0))


def test_ratios_and_bandwidth_are_per_node_update() -> None:
    small = make_row("small", [100, 100], num_nodes=10)
    assert measure_speed(small).median == pytest.approx(1e-3)
    assert compare(make_row("large", [100, 100]), small).median == pytest.approx(1e5)
    # 9 populations of 4 bytes, each read and written once
    assert measure_bandwidth(make_row("a", [1000, 1000])) == pytest.approx((72.0,) * 3)


def test_results_come_back_from_their_file_as_they_were(results: Results, tmp_path: Path) -> None:
    results.save(tmp_path / "folder" / "results.json")
    assert Results.load(tmp_path / "folder" / "results.json") == results


def test_targets_compare_with_the_fastest_of_the_others(results: Results) -> None:
    lines = {line[0]: line[1:] for line in list_targets(results)}
    assert lines["flow and walls / lbmpy's in-place kernel"] == [
        "≥ 0.8 ×", "0.77 ×", "MISSED",
    ]  # fmt: skip
    assert lines["flow and walls / lbmpy's two-buffer step"][-1] == "met"
    assert lines["flow and walls / numba"][1:] == ["–", "not measured"]
    assert lines["GPU, bulk / copy"][-1] == "not measured"  # its copy is missing too
    assert lines["share of an environment step outside the flow"] == ["≤ 2 %", "1.00 %", "met"]
    assert lines["memory per node and flow"][-1] == "met"
    assert lines["compile, cold"][-1] == lines["compile, warm"][-1] == "met"


def test_tables_hold_what_was_measured(results: Results) -> None:
    text = "\n".join(list_tables(results))
    for word in (
        "MISSED", "not measured", "kernel", "with walls", "with fish", "B / update", "36.0",
        "1300 [1295, 1305]", "share outside the flow", "44.0",
        "4 × 9", "60.00",
    ):  # fmt: skip
        assert word in text, word
    for table in list_tables(results):
        lines = [line for line in table.splitlines() if line.startswith("|")]
        assert len({line.count("|") for line in lines}) == 1, table


def test_the_machine_the_protocol_and_who_was_left_out_are_named(results: Results) -> None:
    text = describe_run(results)
    for word in ("a machine", "2 threads", "L3 32 MB", "torch 2.13.0", "lbmpy 2.0", "3 rounds"):
        assert word in text
    assert "Left out: numba (peers): No module 'numba'." in text


def test_every_figure_is_drawn_that_was_measured(results: Results, tmp_path: Path) -> None:
    files = write_plots(results, tmp_path / "figures")
    assert [file.name for file in files] == ["roofline.png", "scaling.png"]
    for file in files:
        with Image.open(file) as image:
            assert min(image.size) > 300
    results.rows = []
    assert write_plots(results, tmp_path) == {}
    assert len(list_tables(results)) == 1  # the goals


def test_the_page_changes_between_its_marks_alone(results: Results, tmp_path: Path) -> None:
    page = tmp_path / "performance.md"
    page.write_text(f"before\n\n{BEGIN}\nlast year\n{END}\n\nafter\n")
    for _ in range(2):  # again gives the same
        files = write_page(results, tmp_path)
        text = page.read_text()
        assert text.startswith(f"before\n\n{BEGIN}\n")
        assert text.endswith(f"\n{END}\n\nafter\n")
        assert "last year" not in text
        assert "| 1 × 1000 × 1000, large/walls | fishrl | with walls | 1000 [995, 1005]" in text
    assert all(file.is_file() for file in files)
    assert "](figures/benchmark/roofline.png)" in text
