"""Programs of the Kármán gait study, on kinematic fish."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import pytest
import torch
from scipy import stats

from experiments import changing_streams, drift_sweep, free_stream, gait_page
from fishrl.envs.macro_actions import DirectFrequencies
from fishrl.envs.streams import Stream
from fishrl.programs import transfer as transfer_program
from fishrl.programs.gait.trials import Histories, load_trial, make_trial
from fishrl.programs.transfer import TransferSettings, transfer
from tests.programs.gait.tasks import BRIEF, OVERRIDES, make_task

pytestmark = pytest.mark.usefixtures("kinematic")


def test_policies_of_one_name_or_of_different_tasks_are_refused(tmp_path: Path) -> None:
    settings = TransferSettings(task=None, episodes=1, folder=str(tmp_path))
    pid = make_trial("pid", make_task(), periods=BRIEF)
    with pytest.raises(ValueError, match="all of different names"):
        transfer([pid, pid], settings)
    other = make_trial("bang_bang", make_task(reynolds=400.0), periods=BRIEF)
    with pytest.raises(ValueError, match="tasks differ in reynolds"):
        transfer([pid, other], settings)
    stream = Stream(speeds_bl=(1.0, 1.0), diameter_bl=(0.4, 0.5))
    control = DirectFrequencies(frequencies=(0.5, 1.0))
    task = make_task(stream=stream, control=control, start_flows=(0,))
    several = make_trial("bang_bang", task, periods=BRIEF)
    with pytest.raises(ValueError, match="several half discs"):
        transfer([several], settings)


@pytest.mark.parametrize("program", [transfer_program, changing_streams])
def test_runs_bring_their_own_task(program: Any, tmp_path: Path) -> None:
    with pytest.raises(SystemExit, match="the runs bring their own"):
        program.main(["runs=[zoo/gait_small]", "task.reynolds=900", f"folder={tmp_path}"])


def test_the_free_stream_is_held_without_a_disc(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    settings = ["episodes=1", "periods=4", "max_frequency=2", "frequency=1", "max_wall_speed=0.15"]
    free_stream.main([*OVERRIDES, *settings, f"folder={tmp_path}"])
    result = json.loads((tmp_path / "free_stream.json").read_text())
    assert [row["episodes"] for row in result["flows"]] == [1, 1, 1]
    assert result["flows"][0]["work_error"] is None  # a single episode
    assert [len(flow["work"]) for flow in result["work"]] == [5, 5, 5]  # at 0 to 4 T
    assert "1.25 L/T:" in capsys.readouterr().out


def test_drift_is_swept_over_frequencies_in_every_stream(tmp_path: Path) -> None:
    settings = ["frequencies=[0.5,1]", "starts=2", "periods=3", f"folder={tmp_path}"]
    drift_sweep.main([*OVERRIDES, *settings])
    with (tmp_path / "drift.csv").open(newline="") as file:
        rows = [row for row in csv.DictReader(file) if float(row["samples"]) > 0]
    assert {row["stream_speed_bl"] for row in rows} == {"1.0", "1.25", "1.5"}
    # kinematic fish swim 0.4 L in a beat, upstream, whatever the stream
    for row in rows:
        expected = -0.4 * float(row["frequency"])
        assert float(row["drift"]) == pytest.approx(expected, abs=0.02)
    facts = json.loads((tmp_path / "drift.json").read_text())
    assert (facts["episodes"], facts["diverged"]) == (12, 0)


def test_the_error_of_the_drift_is_over_episodes() -> None:
    num, drifts = 12, torch.tensor([0.01, 0.02, 0.06])
    time = torch.arange(num + 1.0)
    x = (1.0 + drifts[:, None] * time).double()
    nothing, rows = torch.zeros(3), torch.zeros(3, num + 1).double()
    histories = Histories(*[nothing] * len(Histories._fields))._replace(
        place=torch.stack((x, rows), -1), work=rows, frequency=rows[:, 1:],
        lengths_T=torch.full((3,), 100.0).double(), flow=torch.zeros(3, dtype=torch.int64),
    )  # fmt: skip
    task = make_task()
    row = drift_sweep.tabulate(task, histories)[0]  # 0.8 to 1.4 L: most of each episode
    means = drifts.numpy() / task.interval_T
    assert row["error"] == pytest.approx(stats.sem(means), rel=1e-5)


def test_the_page_takes_the_tables_of_several_transfer_tests(tmp_path: Path) -> None:
    for name in ("pid", "fixed-0.6"):
        trial = make_trial(name, make_task(), periods=BRIEF)
        settings = TransferSettings(task=None, episodes=2, folder=str(tmp_path / name))
        transfer([trial], settings)
    page, given = tmp_path / "karman_gait.md", [f"docs={tmp_path}"]
    page.write_text("<!-- transfer: begin -->\n<!-- transfer: end -->")
    studies = tmp_path / "gait_studies.md"
    studies.write_text("<!-- design: begin -->\n<!-- design: end -->")
    given += [f"transfer={tmp_path / 'pid'}", f"beside={tmp_path / 'fixed-0.6'}"]
    gait_page.main([*given, f"design={{half T:{tmp_path / 'pid'}}}"])
    results = json.loads((tmp_path / "pid" / "transfer.json").read_text())
    lasted = results["arms"]["pid"][0]["survival_T"]
    assert f"| half T | 2 | {lasted:.0f} ± " in studies.read_text()
    rows = [line.split(" | ")[0] for line in page.read_text().splitlines()]
    assert [rows.count(f"| {name}") for name in ("pid", "fixed-0.6")] == [9, 9]
    assert rows.index("| pid") < rows.index("| fixed-0.6")
    other = results | {"speeds_bl": [1.1, 1.3, 1.4]}
    (tmp_path / "fixed-0.6" / "transfer.json").write_text(json.dumps(other))
    with pytest.raises(ValueError, match="beside: results in different streams"):
        gait_page.main.run(gait_page.main.read(given))


def test_no_part_of_the_page_overwrites_the_figures_of_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gait_page, "SETTLED_T", 0.0)
    policy, docs, free = "zoo/gait_small", tmp_path / "docs", tmp_path / "free"
    trial = load_trial(Path(policy), periods=BRIEF)
    transfer([trial], TransferSettings(task=None, episodes=2, folder=str(tmp_path)))
    few = ["episodes=1", "periods=4", "max_frequency=2", "frequency=1", "max_wall_speed=0.15"]
    free_stream.main([*OVERRIDES, *few, f"folder={free}"])
    (tmp_path / "robustness.md").write_text("![beside others](robustness.png)")
    (tmp_path / "robustness.png").write_bytes(b"a figure")
    names = ("transfer", "narrow", "work", "narrow_work", "robustness")
    docs.mkdir()
    page, pictures = docs / "karman_gait.md", docs / "figures" / "gait"
    page.write_text("".join(f"<!-- {name}: begin -->\n<!-- {name}: end -->\n" for name in names))
    shown, kept = [f"transfer={tmp_path}"], dict[str, int]()
    work, narrow = [f"free_stream={free}"], ["part=narrow", f"runs=[{policy}]"]
    for given in ([*shown, *work], [*shown, *work, *narrow], shown, [f"robustness={tmp_path}"]):
        gait_page.main([f"docs={docs}", *given])
        written = {path.name: path.stat().st_mtime_ns for path in pictures.iterdir()}
        again = {name for name, time in kept.items() if written[name] != time}
        assert again == ({f"{name}.png" for name in gait_page.COPIED} if given == shown else set())
        kept = written
    narrow_ones = {f"narrow_{name}.png" for name in ("training", "period", "work")}
    copied = {f"{prefix}{name}.png" for prefix in ("", "narrow_") for name in gait_page.COPIED}
    assert set(kept) == {*narrow_ones, *copied, "work.png", "robustness.png"}
    assert "![beside others](figures/gait/robustness.png)" in page.read_text()
