"""Naming the flow: what is written, through resets of single rows too, and what is refused."""

from __future__ import annotations

from itertools import pairwise, product
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.data import Categorical, Composite, Unbounded
from torchrl.envs import CatFrames, EnvBase, StepCounter, TransformedEnv, check_env_specs

from fishrl.envs import FlowEnv, Predation, PredictedFlowLabel, TrueFlowLabel, make_recognition
from fishrl.envs.extensions import HasFlowLabels
from fishrl.modules import LateralLineClassifier
from tests.envs.conftest import SMALL
from tests.sines import FLOWS, NUM_FEATURES, SENSORS, make_signal


class SineTask(HasFlowLabels):
    """What a transform asks of a task."""

    flow_labels = FLOWS
    lateral_line_layout = SENSORS


class SineEnv(EnvBase):
    """Rows that feel sines; row b's episodes end after b + 2 steps and change the flow."""

    def __init__(self, num_envs: int = 3) -> None:
        super().__init__(batch_size=[num_envs])
        self.task = SineTask()
        self.age = torch.zeros(num_envs)
        self.flow = torch.arange(num_envs) % 3
        self.observation_spec_unbatched = Composite(
            observation=Unbounded((2,)),
            lateral_line=Unbounded((16, 5, NUM_FEATURES)),
            flow_index=Unbounded((1,), dtype=torch.int64),
        )
        self.action_spec_unbatched = Categorical(2)
        self.reward_spec_unbatched = Unbounded((1,))

    def _sense(self) -> dict[str, torch.Tensor]:
        phase = 0.7 * torch.arange(float(len(self.flow)))
        return {
            "observation": torch.stack((self.age, phase), -1),
            "lateral_line": make_signal(self.flow, self.age, phase),
            "flow_index": self.flow.unsqueeze(-1).clone(),
        }

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        rows = torch.ones_like(self.flow, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(self.batch_size)
            self.flow = torch.where(rows, (self.flow + 1) % 3, self.flow)
        self.age = torch.where(rows, 0.0, self.age)
        return TensorDict(self._sense(), self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        self.age = self.age + 1.0
        done = (self.age >= 2.0 + torch.arange(len(self.age))).unsqueeze(-1)
        flags = {"done": done, "terminated": done.clone(), "reward": torch.zeros(done.shape)}
        return TensorDict({**self._sense(), **flags}, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        pass


def make(*transforms: Any, num_envs: int = 3) -> TransformedEnv:
    env = TransformedEnv(SineEnv(num_envs))
    for transform in transforms:
        env.append_transform(transform)
    return env


def untrained(**changes: Any) -> LateralLineClassifier:
    arguments = {"flows": FLOWS, "sensors": SENSORS, "hidden": (8,)} | changes
    return LateralLineClassifier(**arguments, generator=torch.Generator().manual_seed(0))


@pytest.mark.parametrize("num_samples", [16, 40])
def test_the_specs_hold_with_stacked_frames_behind(num_samples: int) -> None:
    stack = CatFrames(N=2, dim=-1, in_keys=["observation"], out_keys=["observation_stack"])
    env = make(*make_recognition(untrained(num_samples=num_samples)), StepCounter(), stack)
    check_env_specs(env, seed=0)
    assert env.observation_spec["observation_stack"].shape == (3, 2 * (2 + 3))


def test_without_memory_probabilities_class_and_observation_say_what_the_machine_says() -> None:
    machine = untrained()
    rollout = make(*make_recognition(machine, memory=0.0)).rollout(6, break_when_any_done=False)
    for td in (rollout, rollout["next"]):
        expected = machine(td["lateral_line"]).softmax(-1)
        assert torch.allclose(td["flow_probabilities"], expected)
        assert torch.equal(td["flow_class"], expected.argmax(-1))
        assert td["flow_class"].dtype == torch.int64
        assert td["observation"].shape == (3, 6, 5)
        assert torch.equal(td["observation"][..., 2:], td["flow_probabilities"])


@pytest.mark.parametrize("oracle", [True, False])
def test_named_but_not_observed_the_observation_stays_as_it_is(oracle: bool) -> None:
    if oracle:
        env = make(TrueFlowLabel(num_flows=3, is_observed=False))
    else:
        env = make(*make_recognition(untrained(), is_observed=False))
    check_env_specs(env, seed=0)
    rollout = env.rollout(3)
    assert rollout["observation"].shape[-1] == 2
    named = rollout["flow_probabilities"].argmax(-1)
    assert torch.equal(rollout["flow_class"], named)


def test_a_row_reset_alone_starts_its_history_anew_and_leaves_the_others() -> None:
    env = make(*make_recognition(untrained(num_samples=32)))
    td = env.rollout(3, break_when_any_done=False)[:, -1].exclude("action")["next"]
    before = td.clone()
    td = env.reset(td.set("_reset", torch.tensor([[False], [True], [False]])))
    history, signal = td["lateral_line_history"], td["lateral_line"]
    assert torch.equal(history[1, :16], signal[1]) and torch.equal(history[1, 16:], signal[1])
    for row in (0, 2):
        assert torch.equal(history[row], before["lateral_line_history"][row])
        assert torch.equal(td["flow_probabilities"][row], before["flow_probabilities"][row])
    said = env.transform[1].machine(history).softmax(-1)
    assert torch.allclose(td["flow_probabilities"][1], said[1])


def test_what_the_machine_said_before_counts_less_and_less_and_not_beyond_the_episode() -> None:
    machine = untrained()
    env = make(PredictedFlowLabel(machine=machine, memory=0.5))
    rollout = env.rollout(6, break_when_any_done=False)
    said = machine(rollout["lateral_line"]).log_softmax(-1)
    age, total = rollout["observation"][..., 0], torch.zeros(3, 3)
    for k in range(6):
        total = torch.where((age[:, k] == 0.0)[:, None], 0.0, 0.5 * total) + said[:, k]
        assert torch.allclose(rollout["flow_probabilities"][:, k], total.softmax(-1), atol=1e-6)
    assert (age == 0.0).sum(1).tolist() == [3, 2, 2]  # episodes begin at different times


def test_with_a_switching_rate_probabilities_are_those_of_the_hidden_markov_model() -> None:
    """Against the sum over every path of flows, each weighted by its probability."""
    machine, rate, num = untrained(), 0.3, 5
    env = make(PredictedFlowLabel(machine=machine, memory=1.0, switching_rate=rate), num_envs=9)
    rollout = env.rollout(num, break_when_any_done=False)[8]  # a row whose episode does not end
    said = machine(rollout["lateral_line"]).softmax(-1).double()
    transition = (1.0 - rate) * torch.eye(3).double() + rate / 3.0
    for k in range(num):
        total = torch.zeros(3, dtype=torch.float64)
        for path in product(range(3), repeat=k + 1):
            weight = said[0, path[0]]
            for i, (before, now) in enumerate(pairwise(path), 1):
                weight = weight * transition[before, now] * said[i, now]
            total[path[-1]] += weight
        expected = (total / total.sum()).float()
        torch.testing.assert_close(rollout["flow_probabilities"][k], expected)


def test_the_mean_label_lies_between_the_flows_that_are_probable() -> None:
    env = make(*make_recognition(untrained(), interpolates=True))
    check_env_specs(env, seed=0)
    rollout = env.rollout(6, break_when_any_done=False)
    p = rollout["flow_probabilities"]
    torch.testing.assert_close(rollout["flow_class"], p[..., 1] + 2.0 * p[..., 2])


@pytest.mark.parametrize("name", ["memory", "switching_rate"])
def test_a_share_beyond_one_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name} = 1\.5: must lie in \[0, 1\]"):
        make_recognition(untrained(), **{name: 1.5})


def test_a_saved_environment_names_flows_as_before() -> None:
    first, second = (make(*make_recognition(untrained(num_samples=32))) for _ in range(2))
    for parameter in second.transform[1].machine.parameters():
        parameter.add_(1.0)
    td = first.rollout(2)[:, -1]["next"]
    second.reset()
    second.load_state_dict(first.state_dict())
    second.base_env.age, second.base_env.flow = first.base_env.age, first.base_env.flow
    action = torch.zeros(3, dtype=torch.int64)
    after = [
        env.step(TensorDict({"action": action}, [3]))["next", "flow_probabilities"]
        for env in (first, second)
    ]
    assert torch.equal(*after) and not torch.equal(after[0], td["flow_probabilities"])


def test_the_machine_is_frozen() -> None:
    machine = untrained().train()
    PredictedFlowLabel(machine=machine)
    assert not machine.training
    assert not any(parameter.requires_grad for parameter in machine.parameters())


def test_the_oracle_names_the_true_flow() -> None:
    env = make(TrueFlowLabel(num_flows=3))
    check_env_specs(env, seed=0)
    rollout = env.rollout(10, break_when_any_done=False)
    assert torch.equal(rollout["flow_class"], rollout["flow_index"].squeeze(-1))
    assert torch.equal(rollout["observation"][..., 2:].argmax(-1), rollout["flow_class"])


def test_a_classifier_for_other_flows_or_sensors_is_refused_when_it_is_attached() -> None:
    other = untrained(flows=[*FLOWS[:2], {**FLOWS[2], "stream_speed_bl": 2.0}])
    with pytest.raises(ValueError, match=r"stream_speed_bl = 2\.0, here it is 1\.5"):
        make(PredictedFlowLabel(machine=other))


@pytest.mark.usefixtures("kinematic")
def test_a_task_without_a_lateral_line_is_refused() -> None:
    env = TransformedEnv(FlowEnv(task=Predation(**SMALL), num_envs=1, compile_flow=False))
    with pytest.raises(ValueError, match="Predation has no lateral line"):
        env.append_transform(PredictedFlowLabel(machine=untrained()))
    with pytest.raises(ValueError, match="0 labelled flows"):
        env.append_transform(TrueFlowLabel(num_flows=3))
