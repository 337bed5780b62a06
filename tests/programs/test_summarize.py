"""From run folders to tables and curves: groups, statistics, and which runs to repeat."""

import csv
import errno
import fcntl
import json
from pathlib import Path
from typing import Any

import pytest

from fishrl.envs import Oracle
from fishrl.programs import summarize
from fishrl.programs.statistics import find_improvement, find_interquartile_mean
from fishrl.programs.summarize import average, tabulate_differences
from fishrl.programs.sweeps.groups import group_runs
from fishrl.programs.sweeps.runs import advise, read_run, read_runs
from fishrl.settings import describe
from fishrl.training import Classifier
from fishrl.training.run_folder import HeldError, RunFolder, write_yaml


def write_run(
    sweep: Path,
    name: str,
    *,
    seed: int = 0,
    curve: dict[int, float] | None = None,
    summary: dict[str, Any] | None = None,
    **settings: Any,
) -> Path:
    folder = RunFolder(sweep / name)
    folder.path.mkdir(parents=True)
    config = {"task": {"_target_": "fishrl.envs.Predation"}, "seed": seed, "total_frames": 100}
    write_yaml(folder.config, config | {"name": name, "folder": str(sweep)} | settings)
    if curve is not None:
        rows = "".join(f"{x},{y},{y / 10}\n" for x, y in curve.items())
        folder.metrics.write_text(f"frames,eval/mean_return,eval/success_rate\n{rows}")
    if summary is not None:
        folder.summary.write_text(json.dumps({"success": "captured", "seed": seed, **summary}))
    return folder.path


def summary_of(value: float) -> dict[str, Any]:
    rates = {"success_rate": value / 10, "mean_return": value, "mean_length_T": 3.0}
    return rates | {"mean_time_to_success_T": None, "wall_seconds": 90.0, "baselines": []}


@pytest.fixture
def sweep(tmp_path: Path) -> Path:
    """Two values of gamma with four seeds each; one run failed, one was stopped."""
    for gamma, values in ((0.9, (1.0, 2.0, 3.0, 10.0)), (0.99, (5.0, 7.0))):
        for seed, value in enumerate(values):
            given: Any = {"curve": {0: 0.0, 100: value}, "summary": summary_of(value)}
            write_run(tmp_path, f"gamma_{gamma}-seed_{seed}", seed=seed, gamma=gamma, **given)
    path = write_run(tmp_path, "gamma_0.99-seed_2", seed=2, gamma=0.99)
    (path / "failure.txt").write_text("Traceback ...\nRuntimeError: out of memory\n")
    path = write_run(tmp_path, "gamma_0.99-seed_3", seed=3, gamma=0.99, curve={0: 0.0, 50: 4.0})
    with (path / "metrics.csv").open("a") as file:
        file.write("6")  # killed while writing
    return tmp_path


def test_interquartile_mean_drops_outer_quarters() -> None:
    assert find_interquartile_mean([10.0, 1.0, 2.0, 3.0]).value == 2.5
    assert find_interquartile_mean([1.0, 2.0, 9.0]).value == 4.0
    assert find_interquartile_mean([*range(8), 100.0]).value == 4.0  # two at either end: 2 ... 6
    assert find_interquartile_mean([]).show(".1f") == "–"


def test_probability_of_improvement_counts_pairs() -> None:
    found = find_improvement([1.0, 2.0, 3.0], [0.0, 2.0])
    assert found.value == pytest.approx(4.5 / 6.0)  # 1 > 0, 2 > 0, 3 > 0, 3 > 2, and one tie
    five, six = [1.0, 2.0, 3.0, 4.0, 5.0], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert find_improvement(six, five).show(".2f") == "0.58"
    found = find_improvement(six, six)
    assert 0.0 <= found.low < found.value < found.high <= 1.0


def test_classifiers_split_groups(tmp_path: Path) -> None:
    classifier = describe(Classifier(path="classifier.pt"))
    for name, content in (("a", b"1"), ("b", b"2"), ("c", b"1")):
        path = write_run(tmp_path, name, recognition=classifier)
        (path / "classifier.pt").write_bytes(content)
    write_run(tmp_path, "d", recognition=describe(Oracle()))
    write_run(tmp_path, "e", recognition=classifier)  # which is lost
    groups = group_runs(read_runs(tmp_path))
    assert [[run.path.name for run in group.runs] for group in groups] == [
        *(["a", "c"], ["b"], ["d"], ["e"])
    ]
    # sha256sum of the one byte
    paths = [group.settings["recognition.path"] for group in groups]
    assert paths[:3] == ["classifier 6b86b273", "classifier d4735e3a", "–"]


def test_groups_are_labelled_by_the_fewest_settings(tmp_path: Path) -> None:
    for preset, frames, length in (("small", 10, 50), ("paper", 20, 100)):
        for gamma in (0.9, 0.99):
            task = {"_target_": "fishrl.envs.Predation", "body_length": length}
            settings = {"preset": preset, "gamma": gamma, "total_frames": frames, "task": task}
            write_run(tmp_path, f"{preset}-{gamma}", **settings)
    groups = group_runs(read_runs(tmp_path))
    assert {tuple(group.settings) for group in groups} == {("preset", "gamma")}
    assert len(groups) == 4


def test_repeated_seed_counts_once(tmp_path: Path) -> None:
    for trial, (seed, value) in enumerate([(0, 4.0), (0, 4.0), (0, 4.0), (1, 6.0)]):
        curve, summary = {0: 0.0, 100: value}, summary_of(value)
        write_run(tmp_path, f"trial_{trial}", seed=seed, curve=curve, summary=summary)
    (group,) = group_runs(read_runs(tmp_path))
    assert sorted(group.numbers("mean_return")) == [4.0, 6.0]
    assert average(group, "eval/mean_return").y.tolist() == [0.0, 5.0]


def test_summary_table_has_intervals_and_reruns(sweep: Path) -> None:
    text = summarize.summarize(sweep)
    rows = [line for line in text.splitlines() if line.startswith("| 0.9")]
    assert rows[0].startswith("| 0.9 | 4 | 40.0% [-25.0%, 105.0%] | 25.0% |")
    assert "| 4.00 [-2.50, 10.50] | 2.50 |" in rows[0] and "| 0.200 [" in rows[0]
    assert rows[1].startswith("| 0.99 | 2/4 |")
    assert "6 of 8 runs finished" in text
    assert "gamma_0.99-seed_2: failed at frame 0 (RuntimeError: out of memory)" in text
    assert "gamma_0.99-seed_3: stopped at frame 50" in text
    assert f"fishrl train resume={sweep}/gamma_0.99-seed_3" in text
    assert "seed_0: " not in text
    assert (sweep / "summary.md").read_text() in text
    # a run whose pictures failed is finished
    (sweep / "gamma_0.9-seed_0" / "failure.txt").write_text("ValueError: no driver\n")
    text = summarize.summarize(sweep, paths=sorted(sweep.glob("gamma_0.9-*")))
    assert "4 of 4 runs finished" in text
    assert "gamma_0.9-seed_0: finished at frame 100 (ValueError: no driver)" in text


def test_groups_are_compared_seed_by_seed(tmp_path: Path) -> None:
    for algorithm, values in (("dqn", (1.0, 2.0, 3.0)), ("sac", (2.0, 4.1, 6.2))):
        for seed, value in enumerate(values):
            curve = {0: 0.0, 100: value}
            summary = summary_of(value) | {"frames": 100, "updates": 400}
            name = f"{algorithm}-{seed}"
            settings: Any = {"seed": seed, "algorithm": {"_target_": algorithm}}
            write_run(tmp_path, name, curve=curve, summary=summary, **settings)
    text = summarize.summarize(tmp_path)
    assert "100 frames and 400 gradient steps each." in text
    # Returns differ by -1, -2.1 and -3.2: deviation 1.1, t of 2 degrees of freedom 4.303. Rates of
    # success are a tenth, their curves' means half of that.
    half = 4.303 * 1.1 / 3**0.5
    low, high = -2.1 - half, -2.1 + half
    rates, returns = f"[{10 * low:.1f}%, {10 * high:.1f}%]", f"[{low:.2f}, {high:.2f}]"
    assert f"| sac | -21.0% {rates} | -2.10 {returns} | -0.105 [" in text
    groups = group_runs(read_runs(tmp_path))
    for run in groups[1].runs:
        run.summary["mean_return"] += 10.0
    assert "| **-12.10 [" in tabulate_differences(groups)  # the interval excludes zero
    path = tmp_path / "dqn-0" / "summary.json"
    path.write_text(json.dumps(summary_of(1.0) | {"frames": 50, "updates": 400}))
    assert "Efforts differ" in summarize.summarize(tmp_path)


def test_csv_files_hold_all_runs(sweep: Path) -> None:
    summarize.summarize(sweep)
    with (sweep / "summary.csv").open(newline="") as file:
        rows = {(row["gamma"], row["metric"]): row for row in csv.DictReader(file)}
    row = rows["0.9", "mean_return"]
    assert (row["seeds"], row["mean"], row["iqm"]) == ("4", "4", "2.5")
    assert float(row["ci95_high"]) - 4.0 == pytest.approx(4.0 - float(row["ci95_low"]))
    measured = {name for name, value in summary_of(0.0).items() if isinstance(value, float)}
    assert {metric for _, metric in rows} == measured | {"curve_mean"}
    with (sweep / "runs.csv").open(newline="") as file:
        runs = {row["run"]: row for row in csv.DictReader(file)}
    assert len(runs) == 8
    assert runs["gamma_0.99-seed_2"]["status"] == "failed"
    assert runs["gamma_0.9-seed_3"]["mean_return"] == "10.0"


def test_curves_average_runs_that_reached_a_frame(sweep: Path) -> None:
    groups = group_runs(read_runs(sweep))
    _, frames, mean, half, _ = average(groups[1], "eval/mean_return")
    assert frames.tolist() == [0.0, 50.0, 100.0]
    assert mean.tolist() == pytest.approx([0.0, (2.5 + 3.5 + 4.0) / 3, 6.0])
    assert half[2] == pytest.approx(12.706, abs=1e-3)  # of 5 and 7: t 12.706, deviation sqrt(2)
    assert average(groups[1], "nothing").x.size == 0


def test_incomplete_runs_are_named(tmp_path: Path) -> None:
    (tmp_path / "lateral-line").mkdir()  # a study that trains no policy
    write_yaml(tmp_path / "lateral-line" / "config.yaml", {"num_samples": 6000, "seed": 0})
    (tmp_path / "gamma_2").mkdir()
    (tmp_path / "gamma_2" / "failure.txt").write_text("gamma = 2: must be at most 1\n")
    with pytest.raises(ValueError, match=r"no run has begun\n.*\n.*gamma_2: .* must be at most 1"):
        summarize.summarize(tmp_path)
    assert "fix the setting" not in advise([read_run(tmp_path / "gamma_3")])  # not begun yet
    run = write_run(tmp_path, "run")
    text = summarize.summarize(tmp_path)
    assert "fix the setting" in text and "| 0/1 | – | – |" in text
    assert not (tmp_path / "curves.png").exists()
    (run / "summary.json").write_text("{")
    with pytest.raises(ValueError, match=r"run/summary.json: damaged .* repair or delete it"):
        read_runs(tmp_path)


def test_file_system_without_locks_is_tolerated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = write_run(tmp_path, "run", summary=summary_of(1.0))

    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with caplog.at_level("INFO"):
        RunFolder(path).hold().close()
    assert "cannot be locked" in caplog.text
    assert read_run(path).status == "finished"


def test_failure_is_recorded_until_retry(tmp_path: Path) -> None:
    path = write_run(tmp_path, "run")
    with pytest.raises(KeyboardInterrupt), RunFolder(path).noting_failure():
        raise KeyboardInterrupt
    with pytest.raises(HeldError), RunFolder(path).noting_failure():
        raise HeldError
    assert read_run(path).status == "stopped"
    with pytest.raises(RuntimeError), RunFolder(path).noting_failure():
        raise RuntimeError("no memory")
    assert (read_run(path).status, read_run(path).reason) == ("failed", "RuntimeError: no memory")
    with RunFolder(path).noting_failure():
        pass
    assert read_run(path).status == "stopped"
