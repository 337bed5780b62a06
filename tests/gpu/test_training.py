"""Training on one device or on two."""

import copy
from pathlib import Path
from typing import Any

import pytest
import torch

from fishrl.envs import Flows, Predation
from fishrl.training import DiscreteSAC, LearningSettings, Plan, open_run, resume
from fishrl.training.algorithms.drqn import DRQN
from fishrl.training.algorithms.sac import SAC
from fishrl.training.loop import Training
from fishrl.training.policy_spec import PolicySpec
from tests.docs.test_tutorials import BRIEF
from tests.envs.test_real_flow import TINY
from tests.objectives.transitions import NUM_ACTIONS, NUM_INPUTS, make_transitions
from tests.training.conftest import assert_equal_weights

pytestmark = pytest.mark.gpu


@pytest.mark.parametrize("algorithm", [DiscreteSAC(), DRQN()], ids=["sac", "drqn"])
@pytest.mark.parametrize(("device", "learner_device"), [("cuda", "cpu"), ("cpu", "cuda")])
@pytest.mark.usefixtures("kinematic")
def test_flows_and_networks_may_change_devices(
    device: str, learner_device: str, algorithm: Any, tmp_path: Path
) -> None:
    def start(name: str, total_frames: int) -> Training:
        plan = Plan(
            task=Predation(**TINY | BRIEF | {"time_limit": 5}), algorithm=algorithm,
            flows=Flows(num_envs=2, compile=False, device=device),
            warmup_frames=8, batch_size=8, hidden=(8,),
            total_frames=total_frames, learner_device=learner_device,
            folder=str(tmp_path), name=name, eval_frames=16, eval_episodes=1, final_episodes=1,
            baselines=(),
        )  # fmt: skip
        return Training(open_run(plan))

    whole = start("whole", 32)
    whole.run()
    assert next(whole.learner.actor.parameters()).device.type == learner_device
    assert whole.learner.buffer[:].device.type == learner_device
    assert whole.collector.env.base_env.device.type == device
    start("parts", 16).run()
    parts = Training(open_run(tmp_path / "parts", total_frames=32))
    parts.run()
    assert_equal_weights(whole, parts)
    parts.close()
    other = Flows(num_envs=2, compile=False, device=learner_device)
    assert resume(tmp_path / "parts", total_frames=40, flows=other)["frames"] == 40


@pytest.mark.parametrize("algorithm", [DiscreteSAC(), SAC()], ids=["discrete", "continuous"])
def test_a_gradient_step_is_one_graph(algorithm: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fishrl.training.tracing.EAGER_CALLS", 1)
    replays, replay = [], torch.cuda.CUDAGraph.replay
    monkeypatch.setattr(
        torch.cuda.CUDAGraph, "replay", lambda graph: (replays.append(graph), replay(graph))
    )
    is_continuous = algorithm.takes_continuous
    sizes = {"num_inputs": NUM_INPUTS, "num_actions": NUM_ACTIONS, "hidden": (8,)}
    spec = PolicySpec(task="", is_continuous=is_continuous, **sizes)
    learner = algorithm.make_learner(spec, LearningSettings(batch_size=8), device="cuda")
    transitions = make_transitions(20)
    transitions["next", "diverged"] = torch.zeros(20, 1, dtype=torch.bool)
    if is_continuous:
        transitions["action"] = torch.rand(20, NUM_ACTIONS)
    learner.store(transitions.to("cuda"))
    learner.update()
    before = copy.deepcopy((learner.loss.state_dict(), learner.optimiser.state_dict()))
    runs = []
    for is_traced in (True, False):
        learner._is_traced = is_traced
        loss, optimiser = copy.deepcopy(before)
        learner.loss.load_state_dict(loss)
        learner.optimiser.load_state_dict(optimiser)
        torch.manual_seed(0)
        runs.append([learner.update() for _ in range(7)])
    assert len(replays) == 4  # one step is as written, one is traced, one runs its operations
    for step, expected in zip(*runs, strict=True):
        torch.testing.assert_close(step, expected)
