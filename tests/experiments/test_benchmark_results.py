"""What the benchmark makes of its times: ratios, goals, tables, figures, the page and the file."""

import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from PIL import Image

from experiments.benchmarks.entry import FISH, KERNEL, OTHER, PERIODIC, PROBE, WALLS
from experiments.benchmarks.goals import MET, MISSED, UNKNOWN, at_least, at_most, judge
from experiments.benchmarks.page import write_page
from experiments.benchmarks.plots import write_plots
from experiments.benchmarks.results import Results, Row, Skipped, Spread, compare, spread
from experiments.benchmarks.tables import (
    describe_run,
    format_spread,
    list_tables,
    render_markdown,
    render_plain,
)

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
        "working_set": 36 * NODES, "bytes_per_update": 72, "num_steps": 2, "unit": "step",
    }  # fmt: skip
    seconds = tuple(NODES / (1e6 * speed) for speed in speeds)
    return Row(label=label, group=group, scope=scope, seconds=seconds, **fields | rest)  # type: ignore[arg-type]


@pytest.fixture
def results() -> Results:
    """Return a run in which everything was measured that there is a table for."""
    fish = {"group": "coupled", "scope": FISH}
    lbmpy = {"group": "peers", "code": "lbmpy"}
    action = {"group": "env", "scope": FISH, "unit": "action"}
    swimming = {"body_length": 50, "period": 562, "flows": 1, "preset": "small"}
    rows = [
        make_row("probe/copy", [700, 710, 690], scope=PROBE, group="probe", code="torch"),
        make_row("probe/in place", [1400, 1390, 1410], scope=PROBE, group="probe", code="torch"),
        make_row("large/walls", [1000, 1010, 990]),
        make_row("large/fish", [800, 810, 790], **fish),
        make_row("lbmpy/aa", [1200, 1210, 1190], scope=KERNEL, **lbmpy),
        make_row("lbmpy/esotwist", [1300, 1310, 1290], scope=KERNEL, **lbmpy),
        make_row("lbmpy/pull, periodic", [500, 505, 495], scope=PERIODIC, **lbmpy),
        *(
            make_row(f"solve/{name}/{n}", [100 * n] * 3, facts={"slip": slip}, **fish)
            for name, slip in (("4 iterations", 7e-3), ("direct", 1e-8))
            for n in (1, 16)
        ),
        make_row("grid/0.5", [400, 410, 390], scope=FISH, group="scaling", facts=swimming),
        make_row(
            "batch/2", [700] * 3, scope=FISH, group="scaling",
            facts=swimming | {"flows": 2, "preset": None},
        ),
        make_row("env/solver", [500, 510, 490], **action),
        make_row("env/policy", [495] * 3, extras={"share_outside_flow": [0.01] * 3}, **action),
        make_row("train/gradient", [200] * 3, scope=OTHER, group="train", num_nodes=0),
    ]  # fmt: skip
    parts = [("flow", "collision", 0.5), ("flow", "edges", 0.2), ("environment", "sensors", 0.01)]
    return Results(
        machine={
            "cpu": "a machine", "cores": 2, "torch": "2.13.0", "python": "3.11", "gpu": None,
            "instructions": "AVX512", "caches": {"L3": 32 * 2**20}, "load": 0.1,
            "versions": {"lbmpy": "2.0"},
        },
        settings={"threads": 2, "rounds": 3, "burst": 0.03, "minutes": 9.0},
        rows=rows,
        skipped=[Skipped("numba", "peers", "No module named 'numba'", False)],
        studies={
            "compile": {"cold": 30.0, "warm": 0.5},
            "memory": {"rows": [{"name": "one flow", "bytes_per_node": 44.0}]},
            "profile": {
                "rows": [{"where": w, "part": p, "seconds": s} for w, p, s in parts],
                "num_envs": 4, "substeps": 562, "size": "500 × 250",
            },
        },
    )  # fmt: skip


def test_a_spread_is_the_median_between_the_quartiles() -> None:
    assert spread([5.0, 1.0, 4.0, 2.0, 3.0]) == Spread(2.0, 3.0, 4.0)


def test_a_ratio_does_not_feel_a_machine_that_slows_down_for_a_round() -> None:
    ours, theirs = make_row("a", [100, 10, 50, 100]), make_row("b", [50, 5, 25, 50])
    assert compare(ours, theirs) == Spread(2.0, 2.0, 2.0)


def test_a_ratio_is_per_node_update_whatever_the_sizes() -> None:
    small = make_row("small", [100, 100], num_nodes=10)
    assert small.mlups.median == pytest.approx(1e-3)
    assert compare(make_row("large", [100, 100]), small).median == pytest.approx(1e5)


def test_rows_of_different_rounds_are_not_compared() -> None:
    with pytest.raises(ValueError, match="'a' has 2 rounds and 'b' 3: only bursts of the same"):
        compare(make_row("a", [1, 1]), make_row("b", [1, 1, 1]))


def test_bandwidth_counts_each_population_once_read_and_once_written() -> None:
    assert make_row("a", [1000, 1000]).bandwidth.median == pytest.approx(72.0)


def test_results_come_back_from_their_file_as_they_were(results: Results, tmp_path: Path) -> None:
    results.save(tmp_path / "folder" / "results.json")
    back = Results.load(tmp_path / "folder" / "results.json")
    assert [vars(row) for row in back.rows] == [vars(row) for row in results.rows]
    assert (back.machine, back.skipped, back.studies) == (
        results.machine, results.skipped, results.studies,
    )  # fmt: skip


def test_the_file_holds_medians_and_quartiles_beside_the_times(
    results: Results, tmp_path: Path
) -> None:
    results.save(tmp_path / "results.json")
    rows = json.loads((tmp_path / "results.json").read_text())["rows"]
    walls = next(row for row in rows if row["label"] == "large/walls")
    assert walls["mlups"] == pytest.approx([995, 1000, 1005], rel=1e-3)
    assert walls["scope"] == WALLS
    assert (walls["bytes_per_update"], walls["working_set"]) == (72, 36 * NODES)
    assert next(row for row in rows if row["label"] == "train/gradient")["mlups"] is None


@pytest.mark.parametrize("text", [None, "no json", "[]", '{"version": 0}'])
def test_other_files_are_refused(tmp_path: Path, text: str | None) -> None:
    path = tmp_path / "results.json"
    if text is not None:
        path.write_text(text)
    with pytest.raises(
        ValueError, match=r"results.json: no .*run .*python -m experiments.benchmark"
    ):
        Results.load(path)


def test_a_goal_is_judged_by_the_fastest_of_the_others(results: Results) -> None:
    goals = [
        at_least(bar, "large/walls", ["lbmpy/aa", "lbmpy/esotwist", "lbmpy/none"], "theirs")
        for bar in (0.76, 0.78)
    ]
    verdicts = judge(results, goals)
    assert [verdict.word for verdict in verdicts] == [MET, MISSED]
    assert verdicts[0].found is not None
    assert verdicts[0].found.median == pytest.approx(1000 / 1300)


def test_a_goal_without_its_numbers_is_not_measured(results: Results) -> None:
    goals = [
        at_least(1.0, "large/walls", ["numba/step"], "a peer that is absent"),
        at_least(1.0, "gpu/fish", ["lbmpy/aa"], "a case that was not run"),
        at_most(1.0, "seconds", "s", lambda r: None),
    ]
    assert [verdict.word for verdict in judge(results, goals)] == [UNKNOWN] * 3


def test_a_ceiling_is_met_from_below(results: Results) -> None:
    goals = [at_most(bar, "seconds", "s", lambda r: 1.0) for bar in (1.0, 0.9)]
    assert [verdict.word for verdict in judge(results, goals)] == [MET, MISSED]


def test_the_goals_of_the_project_are_judged_from_rows_and_studies(results: Results) -> None:
    words = {verdict.goal.what: verdict.word for verdict in judge(results)}
    assert words["flow and walls / lbmpy's in-place kernel"] == MISSED
    assert words["flow and walls / lbmpy's two-buffer step"] == MET
    assert words["flow and walls / numba"] == UNKNOWN
    assert words["share of an environment step outside the flow"] == MET
    assert words["memory per node and flow"] == MET
    assert words["compile, cold"] == words["compile, warm"] == MET


def test_tables_say_what_was_timed_and_against_what(results: Results) -> None:
    text = "\n".join(render_plain(table) for table in list_tables(results))
    for word in (
        "MISSED", "not measured", "kernel", "with walls", "with fish", "B / update", "36.0",
        "1300 [1295, 1305]", "1.0e-08", "small", "share outside the flow", "44.0 B / node",
    ):  # fmt: skip
        assert word in text, word


def test_markdown_tables_have_as_many_cells_in_every_row(results: Results) -> None:
    for table in list_tables(results):
        rows = [line for line in render_markdown(table).splitlines() if line.startswith("|")]
        assert len({row.count("|") for row in rows}) == 1, table.title


def test_a_spread_without_width_is_one_number() -> None:
    assert format_spread(Spread(1.0, 1.0, 1.0)) == "1.00"
    assert format_spread(Spread(1.0, 2.0, 3.0), 1) == "2.0 [1.0, 3.0]"


def test_the_machine_the_protocol_and_who_was_left_out_are_named(results: Results) -> None:
    text = describe_run(results)
    for word in ("a machine", "2 threads", "L3 32 MB", "torch 2.13.0", "lbmpy 2.0", "3 rounds"):
        assert word in text
    assert "Left out: numba (peers): No module named 'numba'." in text


def test_every_figure_is_drawn(results: Results, tmp_path: Path) -> None:
    files = write_plots(results, tmp_path / "figures")
    assert [file.name for file in files] == ["roofline.png", "scaling.png", "profile.png"]
    for file in files:
        with Image.open(file) as image:
            assert min(image.size) > 300


def test_what_was_not_measured_is_not_drawn(results: Results, tmp_path: Path) -> None:
    results.rows, results.studies = [], {}
    assert write_plots(results, tmp_path) == []
    assert [table.title for table in list_tables(results)] == ["Goals"]


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


@pytest.mark.parametrize("text", [None, "", f"{END}\n{BEGIN}\n", f"{BEGIN}\n{BEGIN}\n{END}\n"])
def test_a_page_without_its_marks_is_refused(
    results: Results, tmp_path: Path, text: str | None
) -> None:
    if text is not None:
        (tmp_path / "performance.md").write_text(text)
    with pytest.raises(ValueError, match=r"performance\.md: (no such file|put one line)"):
        write_page(results, tmp_path)
