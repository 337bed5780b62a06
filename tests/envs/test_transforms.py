"""Flow labels: entries, memory, partial resets and refused classifiers."""

from dataclasses import replace
from itertools import pairwise, product
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torchrl.envs import CatFrames, StepCounter, Transform, TransformedEnv, check_env_specs

from fishrl.envs import KarmanGait, Oracle
from fishrl.envs.control import DirectFrequencies
from fishrl.envs.lateral_line import LateralLine
from fishrl.modules import LateralLineClassifier
from fishrl.training import Classifier
from tests.envs.conftest import SMALL, make_flows

pytestmark = pytest.mark.usefixtures("kinematic")
LINE = LateralLine(num_neuromasts=5, num_samples=16, features=("u_x", "u_y"), noise=0.3)
BEATS = DirectFrequencies(frequencies=(1.0, 2.0))
TASK = KarmanGait(
    **SMALL | {"wall_margin_bl": 0.25},
    lateral_line=LINE,
    control=BEATS,
    observes=("place", "flow_label"),
)
FLOWS, NUM_SEEN = TASK.flow_labels, TASK.n_obs


def make(*transforms: Transform, num_envs: int = 3) -> TransformedEnv:
    """Return flows whose fish swim 0.1 L per decision to the danger area, from place to place."""
    number = torch.arange(num_envs + 4)
    starts = TASK.sample_starts(len(number), torch.Generator().manual_seed(0))
    x = TASK.origin[0] + TASK.body_length * (0.55 + 0.2 * number)
    starts["head"][:, 0], starts["flow_index"] = x, number // 2 % 3
    env = TransformedEnv(make_flows(TASK, num_envs, starts=starts))
    for transform in transforms:
        env.append_transform(transform)
    return env


def roll(env: TransformedEnv, num: int) -> TensorDictBase:
    still = torch.zeros(env.batch_size, dtype=torch.int64)
    return env.rollout(num, lambda td: td.set("action", still), break_when_any_done=False)


def untrained(**changes: Any) -> LateralLineClassifier:
    arguments = {"flows": FLOWS, "sensors": TASK.lateral_line_layout, "hidden": (8,)} | changes
    return LateralLineClassifier(**arguments, generator=torch.Generator().manual_seed(0))


def save(folder: Path, *, options: Any = None, **changes: Any) -> Classifier:
    untrained(**changes).save(folder / "classifier.pt")
    return Classifier(path=str(folder), **options or {})


def make_predicted(folder: Path, num_envs: int = 3, **options: Any) -> TransformedEnv:
    return make(*save(folder, options=options).transforms(TASK), num_envs=num_envs)


@pytest.mark.parametrize("num_samples", [16, 40])
def test_specs_hold_in_front_of_a_frame_stack(tmp_path: Path, num_samples: int) -> None:
    stack = CatFrames(N=2, dim=-1, in_keys=["observation"], out_keys=["observation_stack"])
    env = make(*save(tmp_path, num_samples=num_samples).transforms(TASK), StepCounter(), stack)
    check_env_specs(env, seed=0)
    assert env.observation_spec["observation_stack"].shape == (3, 2 * (NUM_SEEN + 3))


def test_without_memory_labels_are_the_classifiers_output(tmp_path: Path) -> None:
    env = make_predicted(tmp_path, memory=0.0)
    rollout = roll(env, 6)
    for td in (rollout, rollout["next"]):
        expected = env.transform[0].classifier(td["lateral_line"]).softmax(-1)
        assert torch.allclose(td["flow_probabilities"], expected)
        assert torch.equal(td["flow_class"], expected.argmax(-1))
        assert td["flow_class"].dtype == torch.int64
        assert td["observation"].shape == (3, 6, NUM_SEEN + 3)
        assert torch.equal(td["observation"][..., NUM_SEEN:], td["flow_probabilities"])


@pytest.mark.parametrize("interpolates", [False, True])
def test_labels_may_be_hidden_and_interpolated(tmp_path: Path, interpolates: bool) -> None:
    recognition = save(tmp_path, options={"interpolates": interpolates})
    env = make(*recognition.transforms(replace(TASK, observes=("place",))))
    check_env_specs(env, seed=0)
    rollout = roll(env, 6)
    assert rollout["observation"].shape[-1] == NUM_SEEN
    p = rollout["flow_probabilities"]
    mean, most = p[..., 1] + 2.0 * p[..., 2], p.argmax(-1)
    torch.testing.assert_close(rollout["flow_class"], mean if interpolates else most)


def test_oracle_writes_the_true_flow() -> None:
    rollout = roll(make(*Oracle().transforms(TASK)), 10)
    assert torch.equal(rollout["flow_class"], rollout["flow_index"].squeeze(-1))
    assert torch.equal(rollout["observation"][..., NUM_SEEN:].argmax(-1), rollout["flow_class"])


def test_partial_reset_restarts_the_history_of_its_rows_alone(tmp_path: Path) -> None:
    env = make(*save(tmp_path, num_samples=32).transforms(TASK))
    td = roll(env, 3)[:, -1].exclude("action")["next"]
    before = td.clone()
    td = env.reset(td.set("_reset", torch.tensor([[False], [True], [False]])))
    history, signal = td["lateral_line_history"], td["lateral_line"]
    assert torch.equal(history[1, :16], signal[1]) and torch.equal(history[1, 16:], signal[1])
    for row in (0, 2):
        assert torch.equal(history[row], before["lateral_line_history"][row])
        assert torch.equal(td["flow_probabilities"][row], before["flow_probabilities"][row])
    said = env.transform[1].classifier(history).softmax(-1)
    assert torch.allclose(td["flow_probabilities"][1], said[1])


def test_memory_discounts_earlier_output_within_an_episode(tmp_path: Path) -> None:
    env = make_predicted(tmp_path, memory=0.5)
    rollout = roll(env, 6)
    said = env.transform[0].classifier(rollout["lateral_line"]).log_softmax(-1)
    ends, total = rollout["next", "done"], torch.zeros(3, 3)
    for k in range(6):
        begins = ends[:, k - 1] if k else torch.ones(3, 1, dtype=torch.bool)
        total = torch.where(begins, 0.0, 0.5 * total) + said[:, k]
        assert torch.allclose(rollout["flow_probabilities"][:, k], total.softmax(-1), atol=1e-6)
    assert ends[:, :5].sum(1).flatten().tolist() == [1, 1, 0]  # at different times


def test_switching_rate_gives_hidden_markov_filter(tmp_path: Path) -> None:
    """Against the sum over every path of flows, each weighted by its probability."""
    rate, num = 0.3, 5
    env = make_predicted(tmp_path, 9, memory=1.0, switching_rate=rate)
    rollout = roll(env, num)[8]  # a row whose episode does not end
    said = env.transform[0].classifier(rollout["lateral_line"]).softmax(-1).double()
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


def test_saved_environment_keeps_weights_and_evidence(tmp_path: Path) -> None:
    """The weights are frozen, so they may be changed in place."""
    recognition = save(tmp_path, num_samples=32)
    first, second = (make(*recognition.transforms(TASK)) for _ in range(2))
    for parameter in second.transform[1].classifier.parameters():
        parameter.add_(1.0)
    assert not second.transform[1].classifier.training
    td = roll(first, 2)[:, -1]["next"]
    second.reset()
    second.load_state_dict(first.state_dict())
    second.base_env.load_state_dict(first.base_env.state_dict())
    action = TensorDict({"action": torch.zeros(3, dtype=torch.int64)}, [3])
    after = [env.step(action.clone())["next", "flow_probabilities"] for env in (first, second)]
    assert torch.equal(*after) and not torch.equal(after[0], td["flow_probabilities"])


@pytest.mark.parametrize("name", ["memory", "switching_rate"])
def test_probabilities_above_1_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=rf"{name} = 1\.5: "):
        save(tmp_path, options={name: 1.5})
