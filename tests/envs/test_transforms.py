"""Flow labels: entries, memory, partial resets and refused classifiers."""

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
    """The flow labels of a task."""

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


def make_predicted(num_envs: int = 3, **options: Any) -> TransformedEnv:
    return make(*make_recognition(untrained(), **options), num_envs=num_envs)


@pytest.mark.parametrize("num_samples", [16, 40])
def test_specs_hold_in_front_of_a_frame_stack(num_samples: int) -> None:
    stack = CatFrames(N=2, dim=-1, in_keys=["observation"], out_keys=["observation_stack"])
    env = make(*make_recognition(untrained(num_samples=num_samples)), StepCounter(), stack)
    check_env_specs(env, seed=0)
    assert env.observation_spec["observation_stack"].shape == (3, 2 * (2 + 3))


def test_without_memory_labels_are_the_classifiers_output() -> None:
    env = make_predicted(memory=0.0)
    rollout = env.rollout(6, break_when_any_done=False)
    for td in (rollout, rollout["next"]):
        expected = env.transform[0].machine(td["lateral_line"]).softmax(-1)
        assert torch.allclose(td["flow_probabilities"], expected)
        assert torch.equal(td["flow_class"], expected.argmax(-1))
        assert td["flow_class"].dtype == torch.int64
        assert td["observation"].shape == (3, 6, 5)
        assert torch.equal(td["observation"][..., 2:], td["flow_probabilities"])


@pytest.mark.parametrize("is_true", [True, False])
def test_labels_that_are_not_observed_leave_the_observation_alone(is_true: bool) -> None:
    true = TrueFlowLabel(num_flows=3, is_observed=False)
    env = make(true) if is_true else make_predicted(is_observed=False)
    check_env_specs(env, seed=0)
    rollout = env.rollout(3)
    assert rollout["observation"].shape[-1] == 2
    assert torch.equal(rollout["flow_class"], rollout["flow_probabilities"].argmax(-1))


def test_partial_reset_restarts_the_history_of_its_rows_alone() -> None:
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


def test_memory_discounts_earlier_output_within_an_episode() -> None:
    env = make_predicted(memory=0.5)
    rollout = env.rollout(6, break_when_any_done=False)
    said = env.transform[0].machine(rollout["lateral_line"]).log_softmax(-1)
    age, total = rollout["observation"][..., 0], torch.zeros(3, 3)
    for k in range(6):
        total = torch.where((age[:, k] == 0.0)[:, None], 0.0, 0.5 * total) + said[:, k]
        assert torch.allclose(rollout["flow_probabilities"][:, k], total.softmax(-1), atol=1e-6)
    assert (age == 0.0).sum(1).tolist() == [3, 2, 2]  # episodes begin at different times


def test_switching_rate_gives_the_filter_of_a_hidden_markov_model() -> None:
    """Against the sum over every path of flows, each weighted by its probability."""
    rate, num = 0.3, 5
    env = make_predicted(9, memory=1.0, switching_rate=rate)
    rollout = env.rollout(num, break_when_any_done=False)[8]  # a row whose episode does not end
    said = env.transform[0].machine(rollout["lateral_line"]).softmax(-1).double()
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


def test_interpolated_label_is_the_mean_over_the_probabilities() -> None:
    env = make_predicted(interpolates=True)
    check_env_specs(env, seed=0)
    rollout = env.rollout(6, break_when_any_done=False)
    p = rollout["flow_probabilities"]
    torch.testing.assert_close(rollout["flow_class"], p[..., 1] + 2.0 * p[..., 2])


@pytest.mark.parametrize("name", ["memory", "switching_rate"])
def test_share_above_1_is_refused(name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name} = 1\.5: must lie in \[0, 1\]"):
        make_recognition(untrained(), **{name: 1.5})


def test_saved_environment_keeps_weights_and_evidence() -> None:
    first, second = (make(*make_recognition(untrained(num_samples=32))) for _ in range(2))
    for parameter in second.transform[1].machine.parameters():
        parameter.add_(1.0)
    td = first.rollout(2)[:, -1]["next"]
    second.reset()
    second.load_state_dict(first.state_dict())
    second.base_env.age, second.base_env.flow = first.base_env.age, first.base_env.flow
    action = TensorDict({"action": torch.zeros(3, dtype=torch.int64)}, [3])
    after = [env.step(action.clone())["next", "flow_probabilities"] for env in (first, second)]
    assert torch.equal(*after) and not torch.equal(after[0], td["flow_probabilities"])


def test_classifier_is_frozen() -> None:
    machine = untrained().train()
    PredictedFlowLabel(machine=machine)
    assert not machine.training
    assert not any(parameter.requires_grad for parameter in machine.parameters())


def test_oracle_writes_the_true_flow() -> None:
    env = make(TrueFlowLabel(num_flows=3))
    check_env_specs(env, seed=0)
    rollout = env.rollout(10, break_when_any_done=False)
    assert torch.equal(rollout["flow_class"], rollout["flow_index"].squeeze(-1))
    assert torch.equal(rollout["observation"][..., 2:].argmax(-1), rollout["flow_class"])


def test_classifier_for_other_flows_is_refused_when_attached() -> None:
    other = untrained(flows=[*FLOWS[:2], {**FLOWS[2], "stream_speed_bl": 2.0}])
    with pytest.raises(ValueError, match=r"stream_speed_bl = 2\.0, here it is 1\.5"):
        make(PredictedFlowLabel(machine=other))


@pytest.mark.usefixtures("kinematic")
def test_task_without_a_lateral_line_is_refused() -> None:
    env = TransformedEnv(FlowEnv(task=Predation(**SMALL), num_envs=1, compile_flow=False))
    with pytest.raises(ValueError, match="Predation has no lateral line"):
        env.append_transform(PredictedFlowLabel(machine=untrained()))
    with pytest.raises(ValueError, match="0 labelled flows"):
        env.append_transform(TrueFlowLabel(num_flows=3))
