"""Watching flows run: which moments are kept, what they carry, and that it disturbs nothing."""

from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from experiments.scenes import Values
from experiments.watching import Watch, run_episodes
from fishrl.envs import Predation, make_env
from fishrl.viewer import Frame
from tests.envs.conftest import SMALL, gliding  # noqa: F401 - a fixture


class FakeTask:
    """Four looks per action and period; a row ends where its head passes x = 100."""

    checks_per_action, n_substeps = 4, 8
    scales = SimpleNamespace(period=8)

    def is_terminated(self, now: TensorDict) -> Tensor:
        return now["head"][:, 0] > 100.0


class FakeEnv:
    """Two rows whose heads lie at (age, row); row 1 jumps behind x = 100 after ``jump`` steps."""

    def __init__(self, *, jump: int = 99) -> None:
        self.age, self.jump = torch.zeros(2), jump
        self.solver = SimpleNamespace(body=SimpleNamespace(age=self.age))
        self.is_resting = torch.zeros(2, dtype=torch.bool)

    def measure(self) -> TensorDict:
        far = torch.tensor([0.0, 200.0]) * (self.age >= self.jump)
        head = torch.stack((self.age + far, torch.tensor([0.0, 1.0])), 1)
        return TensorDict({"head": head}, [2])


def read(env: Any) -> Values:
    return {"head": env.measure()["head"]}


class Given(dict[int, list[Frame]]):
    """The frames of each row."""

    def __init__(self) -> None:
        super().__init__({0: [], 1: []})

    def take(self, row: int, frame: Frame) -> None:
        self[row].append(frame)

    def times(self, row: int) -> list[float]:
        return [frame.time for frame in self[row]]

    def column(self, row: int, name: str) -> list[float]:
        return [float(frame.values[name]) for frame in self[row]]


def make_watch(given: Given, *, frames_per_T: int, **settings: Any) -> Watch:
    return Watch(
        FakeTask(), read, rows=range(2), frames_per_T=frames_per_T, give=given.take, **settings
    )


def act(watch: Watch, env: FakeEnv, **flags: list[bool]) -> set[int]:
    """Run one action of four looks; flags are what the env says after it."""
    for _ in range(4):
        env.age += 2
        watch.look(env)
    none = {"done": [False] * 2, "diverged": [False] * 2}
    after = {name: torch.tensor(value)[:, None] for name, value in {**none, **flags}.items()}
    after["reward"] = env.age[:, None].clone()
    mask = torch.tensor([[True, False, True]] * 2)
    step = {"action": torch.tensor([0, 2]), "action_mask": mask, "next": after}
    return watch.settle(TensorDict(step, [2]))


def test_every_so_many_looks_are_kept_and_carry_what_was_decided_and_what_it_earned() -> None:
    given, env = Given(), FakeEnv()
    watch = make_watch(given, frames_per_T=2)
    watch.keep(env)
    assert act(watch, env) == set()
    assert act(watch, env, done=[True, True]) == {0, 1}
    assert watch.frames_per_T == 2
    assert given.times(1) == [0.0, 0.5, 1.0, 1.5, 2.0]
    assert given.column(1, "reward") == [8.0, 8.0, 8.0, 16.0, 16.0]
    assert given.column(1, "action") == [2.0] * 5
    assert [frame.begins for frame in given[1]] == [True, False, False, False, False]
    assert given[1][0].values["action_mask"].tolist() == [True, False, True]
    assert [frame.values["head"][1].item() for frame in given[1]] == [1.0] * 5


def test_the_look_that_ends_an_episode_is_its_last_frame() -> None:
    given, env = Given(), FakeEnv(jump=6)
    watch = make_watch(given, frames_per_T=1)
    watch.keep(env)
    assert act(watch, env, done=[False, True]) == {1}
    assert given.times(1) == [0.0, 0.75]
    assert watch.running == {0}


def test_a_flow_that_diverges_is_kept_up_to_the_decision_before() -> None:
    given, env = Given(), FakeEnv()
    watch = make_watch(given, frames_per_T=4)
    watch.keep(env)
    act(watch, env)
    act(watch, env, done=[False, True], diverged=[False, True])
    assert given.times(1) == [0.0, 0.25, 0.5, 0.75, 1.0]


def test_of_a_flow_that_diverges_at_once_the_start_is_kept() -> None:
    given, env = Given(), FakeEnv()
    watch = make_watch(given, frames_per_T=4)
    watch.keep(env)
    act(watch, env, done=[False, True], diverged=[False, True])
    assert given.times(1) == [0.0]


def test_without_end_episodes_follow_each_other_on_one_clock() -> None:
    given, env = Given(), FakeEnv()
    watch = make_watch(given, frames_per_T=4, is_once=False)
    act(watch, env, done=[True, False])
    env.age[0] = 0.0
    act(watch, env)
    assert given.times(0) == [0.25, 0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0]
    assert [frame.begins for frame in given[0]] == [True, *[False] * 3] * 2
    assert [frame.begins for frame in given[1]] == [True, *[False] * 7]


def test_flows_that_rest_and_other_episodes_in_between_leave_no_trace() -> None:
    given, env = Given(), FakeEnv()
    watch = make_watch(given, frames_per_T=4, is_once=False)
    act(watch, env)
    env.is_resting = torch.tensor([False, True])
    act(watch, env)
    assert len(given[0]) == 8
    assert len(given[1]) == 4
    env.is_resting = torch.tensor([False, False])
    watch.restart()
    act(watch, env)
    assert given[0][8].begins
    assert given.times(0) == sorted(given.times(0))


def test_frames_that_would_cost_too_much_time_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = [0.0]
    monkeypatch.setattr("experiments.watching.time.monotonic", lambda: clock[0])
    given, env = Given(), FakeEnv()

    def read_slowly(env: Any) -> Values:
        clock[0] += 1.0
        return read(env)

    watch = Watch(
        FakeTask(), read_slowly, rows=range(2), frames_per_T=4, give=given.take,
        is_once=False, share=0.25,
    )  # fmt: skip
    for _ in range(25):
        clock[0] += 0.5 * 4
        act(watch, env)
    # 50 s of flow, and a quarter of all the time for frames of 1 s each
    assert len(given[0]) == pytest.approx(50.0 / 3.0, abs=2.0)


@pytest.mark.usefixtures("gliding")
def test_rows_that_are_through_rest_and_the_env_is_left_as_it_was() -> None:
    task = Predation(**SMALL, time_limit=3)
    env = make_env(task=task, num_envs=3, frames_per_action=task.checks_per_action)
    given, resting = Given(), []

    def keep_straight(td: TensorDict) -> TensorDict:
        resting.append(env.base_env.is_resting.tolist())
        return td.set("action", torch.ones(3, dtype=torch.int64))

    def make(start_of: dict[int, int]) -> Watch:
        assert sorted(start_of.values()) == [0, 1]
        return Watch(
            task, lambda base: {}, rows=start_of, frames_per_T=1,
            give=lambda row, frame: given.take(start_of[row], frame),
        )  # fmt: skip

    starts = task.sample_starts(2, torch.Generator().manual_seed(0))
    run_episodes(env, keep_straight, starts, make_watch=make, max_T=2.0)
    assert given.times(0) == given.times(1) == [0.0, 1.0, 2.0]
    assert [sum(rows) for rows in resting] == [1, 1]  # two starts in three flows
    assert env.base_env.on_frame is None
    assert not env.base_env.is_resting.any()


def test_less_than_a_frame_per_period_is_refused() -> None:
    with pytest.raises(ValueError, match="frames_per_T = 0: at least one"):
        make_watch(Given(), frames_per_T=0)
