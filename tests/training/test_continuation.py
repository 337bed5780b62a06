"""Which settings may change when a run continues."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fishrl.training import DiscreteSAC, begin, find_changes, find_summary, train
from fishrl.training.callback import Callback
from tests.training.conftest import QUICK, Toy, make_toy_plan
from tests.training.toy_fish import make_toy_env


def test_training_a_named_run_again_continues_it_or_returns_its_summary(
    toy: Toy, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Phases(Callback):
        def __init__(self) -> None:
            self.seen: list[str] = []

        def on_phase(self, phase: str, **_: Any) -> None:
            self.seen.append(phase)

    def run(total_frames: int) -> tuple[dict[str, Any], list[str]]:
        plan = make_toy_plan(toy.folder, name="run", total_frames=total_frames, **QUICK)
        phases = Phases()
        summary = train(
            task=plan.task,
            learning=plan.learning,
            run=plan.run,
            preset="toy",
            callbacks=[phases],
            make_env=make_toy_env,
        )
        return summary, phases.seen

    first, _ = run(160)
    again, phases = run(160)
    assert again["frames"] == 160 and again["mean_return"] == first["mean_return"]
    assert phases == []
    longer, phases = run(240)
    assert longer["frames"] == 240 and "warm-up" not in phases  # continued, not begun
    assert [path.name for path in toy.folder.iterdir()] == ["run"]


def test_only_settings_that_do_not_fix_the_result_may_differ(toy: Toy) -> None:
    plan = make_toy_plan(toy.folder, name="run", extra={"pictures": 6}, **QUICK)
    begin(plan, make_env=make_toy_env).close()
    folder = toy.folder / "run"
    changed = replace(
        plan,
        run=replace(plan.run, total_frames=480, log_frames=8, name=None, folder="elsewhere"),
        extra={"pictures": 2},
    )
    assert find_changes(folder, plan) == {}
    changes = find_changes(folder, changed)
    assert changes == {"total_frames": 480, "log_frames": 8, "pictures": 2}
    other = replace(
        plan,
        algorithm=DiscreteSAC(alpha_init=0.5),
        learning=replace(plan.learning, gamma=0.9),
    )
    with pytest.raises(ValueError, match=r"gamma = 0\.9: is 0\.99 in (.*\n)*.*alpha_init = 0\.5"):
        begin(other, make_env=make_toy_env)


def test_a_finished_run_is_finished_unless_frames_or_the_final_evaluation_change(
    toy: Toy,
) -> None:
    toy.begin(name="run", total_frames=16, **QUICK).run()
    toy.trainings[-1].close()
    run: Path = toy.folder / "run"
    for harmless in ({}, {"log_frames": 10}, {"total_frames": 8}):
        assert find_summary(run, **harmless) is not None
    for more in ({"total_frames": 48}, {"final_episodes": 4}, {"baselines": ("random",)}):
        assert find_summary(run, **more) is None
