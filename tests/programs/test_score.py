"""Any policy is scored on held-out starts, and an archive only where its code is trusted."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from sb3_contrib import MaskablePPO
from tensordict import TensorDictBase

from fishrl.benchmark import find_version
from fishrl.envs import Flows, make_env, make_task
from fishrl.programs.score import find_policy, main, score
from fishrl.training import load_plan
from fishrl.training.checkpoint import Checkpoint
from fishrl.wrappers.stable_baselines import FlowVecEnv

pytestmark = pytest.mark.usefixtures("kinematic")
TASK = "predation-quick-v1"
EAGER: dict[str, Any] = {"flows": Flows(num_envs=96, compile=False)}


def go_straight(state: TensorDictBase) -> TensorDictBase:
    assert {*state.keys()} == {"observation_stack", "action_mask", "is_init"}
    return state.set("action", state["action_mask"].int().argmax(-1) * 0 + 1)


def test_function_is_scored_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])
    words = ["policy=mine:go_straight", f"task={TASK}", "split=validation", "trained=7"]
    words += ["flows.compile=false", f"save={tmp_path / 'row.json'}"]
    main(words)
    row, version = json.loads((tmp_path / "row.json").read_text()), find_version(TASK)
    expected = {"policy": "mine:go_straight", "kind": "function", "task": TASK, "differs": None}
    expected |= {"settings": version.settings, "starts": version.starts["validation"]}
    expected |= {"trained_decisions": 7, "split": "validation", "recognition": None}
    assert {name: row[name] for name in expected} == expected
    assert row["metrics"]["episodes"] == 32 and 32 <= row["scored_decisions"] <= 320
    assert row["low"] <= row["value"] <= row["high"] and row["cpu_seconds"] > 0.0
    shown = capsys.readouterr().out
    assert "> mine:go_straight" in shown and "are scored on the test alone" in shown


def test_run_is_scored_with_its_memory_and_what_differs_is_stored() -> None:
    task = make_task("station-line-quick-v1")
    row = score("zoo/gait_bend_line", task=task, split="validation", **EAGER)
    assert row.kind == "run" and row.num_stacked == 16 and row.trained_decisions
    assert "safe_area.aside_bl" in row.differs and "num_stacked" not in row.differs
    assert row.versions.keys() == {"fishrl", "python", "torch", "torchrl", "tensordict"}


def test_row_says_that_a_policy_began_as_another(monkeypatch: pytest.MonkeyPatch) -> None:
    version, plan = find_version("station-v1"), load_plan("zoo/gait_bend")
    key = "initial_policy"
    assert key not in find_policy("zoo/gait_bend", version, trust=False).differs
    monkeypatch.setattr("fishrl.programs.score.load_plan", lambda _: replace(plan, **{key: "x"}))
    assert key in find_policy("zoo/gait_bend", version, trust=False).differs
    monkeypatch.setattr("fishrl.programs.score.read_result", lambda _: {"teacher": "zoo/other"})
    assert "teacher" in find_policy("zoo/gait_bend", version, trust=False).differs


def test_row_has_the_decisions_of_the_training_not_those_of_its_best_checkpoint() -> None:
    name = "zoo/predation_bend"
    found = find_policy(name, find_version("predation-bend-v1"), trust=False)
    assert found.decisions == 11_200 > Checkpoint.find(name).frames


def test_archive_needs_trust_and_acts_as_its_model(tmp_path: Path) -> None:
    task, path = make_task(TASK, num_stacked=5), str(tmp_path / "fish.zip")
    env = FlowVecEnv(make_env(task=task, flows=Flows(num_envs=2, compile=False)))
    model = MaskablePPO("MlpPolicy", env, n_steps=2, batch_size=2, seed=0, device="cpu")
    model.learn(4)
    model.save(path)
    with pytest.raises(ValueError, match=r"unpickles it, which runs any code .* trust=true"):
        score(path, task=task, **EAGER)
    with pytest.raises(FileNotFoundError, match=r"/none\.zip: no such file"):
        score(str(tmp_path / "none.zip"), task=task, trust=True, **EAGER)
    row = score(path, task=task, split="validation", trust=True, **EAGER)
    assert (row.kind, row.num_stacked, row.trained_decisions) == ("archive", 5, 4)

    def act(state: TensorDictBase) -> TensorDictBase:
        seen = state["observation_stack"].numpy().astype(np.float32)
        masks = state["action_mask"].numpy()
        actions, _ = model.predict(seen, deterministic=True, action_masks=masks)
        return state.set("action", state["is_init"][:, 0].long().new_tensor(actions))

    module = type(sys)("model_of_test")
    module.act = act
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(sys.modules, "model_of_test", module)
        same = score("model_of_test:act", task=task, split="validation", **EAGER)
    assert same.metrics == row.metrics
    env.close()
    for other, said in (
        ("predation-bend-quick-v1", r"observes 20 numbers; .* a multiple of 9"),
        ("station-quick-v1", "its action is one of 3 choices; station-quick-v1 has 9 choices"),
    ):
        with pytest.raises(ValueError, match=said):
            score(path, task=make_task(other), trust=True, **EAGER)


def forget_to_return(state: TensorDictBase) -> None:
    state["observation_stack"].zero_()
    state["action"] = state["is_init"][:, 0].long()


@pytest.mark.parametrize(
    ("name", "said"),
    [(None, "must return the TensorDict"), ("random", "must differ from those of baselines")],
)
def test_function_must_return_its_action_under_a_name_of_its_own(
    name: str | None, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "mine", sys.modules[__name__])
    with pytest.raises(ValueError, match=said):
        score("mine:forget_to_return", task=make_task(TASK), name=name, **EAGER)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["policy=random", f"task={TASK}", "task.body_length=24"], "differs from predation-quick"),
        (["policy=random", f"task={TASK}", "split=train"], "there is no 'train'"),
        (["policy=json:dump_it", f"task={TASK}"], "module json has no function 'dump_it'"),
        (["policy=json:JSONEncoder", f"task={TASK}"], "module json has no function"),
        (["policy=fish", f"task={TASK}"], "no baseline of predation-quick-v1.* with its .zip"),
    ],
)
def test_what_cannot_be_scored_is_named(words: list[str], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        main.run(main.read([*words, "flows.compile=false"]))
