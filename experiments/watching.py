"""Looking at flows while they run: which moments are kept, and what was decided in them."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from experiments.scenes import DECIDED, TaskView, Values
from fishrl.envs import episodes
from fishrl.viewer import Drawing, Frame


class Watch:
    """Reads frames within actions, and gives them away once it is known what the action earned.

    Args:
        task: whose flows these are.
        read: returns what the flows of an env look like, ``[B, ...]`` by key.
        rows: which flows to watch.
        frames_per_T: frames per period, about: one of every so many looks that the task takes.
        give: called with row and frame, in the order of time.
        is_once: watch the first episode of each row only, up to the very look at which it ends;
            otherwise episodes follow each other on one clock.
        share: of the wall time that watching may take; frames that would cost more are left out.

    Attributes:
        running: rows whose episode is not over yet.
        frames_per_T: frames per period, as they come.

    Raises:
        ValueError: for less than one frame per period.
    """

    def __init__(
        self,
        task: Any,
        read: Callable[[Any], Values],
        *,
        rows: Iterable[int],
        frames_per_T: int,
        give: Callable[[int, Frame], None],
        is_once: bool = True,
        share: float = 1.0,
    ) -> None:
        if frames_per_T < 1:
            raise ValueError(
                f"frames_per_T = {frames_per_T}: at least one frame per period is needed"
            )
        self.task, self._read, self._give = task, read, give
        self._is_once, self._share = is_once, share
        looks_per_T = task.checks_per_action * task.scales.period / task.n_substeps
        self.stride = max(1, round(looks_per_T / frames_per_T))
        self.frames_per_T = max(1, round(looks_per_T / self.stride))
        self.running = set(rows)
        self._given = set[int]()
        # Frames of the action under way: its reward is known only when it is over.
        self._pending: dict[int, list[Frame]] = {row: [] for row in self.running}
        self._open = set(self.running)
        self._offset_T, self._last_T = (dict.fromkeys(self.running, x) for x in (0.0, -1.0))
        self._begins = set(self.running)
        self._num_looks, self._spent, self._began = 0, 0.0, time.monotonic()

    def restart(self) -> None:
        """Let every row begin an episode with its next frame, and forget what is pending."""
        self._begins = set(self.running)
        self._pending = {row: [] for row in self.running}

    def look(self, env: Any) -> None:
        """Look at the flows within an action: keep every so many, and every end of an episode."""
        self._num_looks += 1
        is_due = self._num_looks % self.stride == 0
        if not self._is_once:
            if is_due and self._spent <= self._share * (time.monotonic() - self._began):
                self.keep(env)
            return
        has_ended = self.task.is_terminated(env.measure()).tolist()
        ending = {row for row in self._open if has_ended[row]}
        self.keep(env, self._open if is_due else ending)
        self._open -= ending

    def keep(self, env: Any, rows: set[int] | None = None) -> None:
        """Keep a frame of some rows, of all by default."""
        rows = self.running if rows is None else rows
        if not rows:
            return
        start = time.monotonic()
        values, ages = self._read(env), env.solver.body.age.tolist()
        is_resting = env.is_resting.tolist()
        for row in rows:
            age_T = ages[row] / self.task.scales.period
            if age_T < self._last_T[row]:
                self._begins.add(row)
            if row in self._begins:
                self._offset_T[row] += max(self._last_T[row], 0.0)
            elif age_T == self._last_T[row] or is_resting[row]:
                continue  # it stands still: its episode is over
            frame = Frame(
                time=self._offset_T[row] + age_T,
                values={name: value[row].cpu().clone() for name, value in values.items()},
                begins=row in self._begins,
            )
            self._begins.discard(row)
            self._last_T[row] = age_T
            self._pending[row].append(frame)
        self._spent += time.monotonic() - start

    def settle(self, step: TensorDictBase) -> set[int]:
        """Give the frames of an action that is over, with what was decided and what it earned.

        Args:
            step: ``[B]``, as the env returns it.

        Returns:
            The rows whose episode it ended.
        """
        start, after, ended = time.monotonic(), step["next"], set()
        for row in self.running:
            decided = {
                "action": step["action"][row].cpu(),
                "reward": after["reward"][row].sum().cpu(),
                **{name: step[name][row].cpu() for name in DECIDED if name in step},
            }
            pending = self._pending[row]
            if after["diverged"][row].any():
                # diverged at once: the start is all there is
                pending = [] if row in self._given else pending[:1]
            for frame in pending:
                values = {**frame.values, **decided}
                self._give(row, Frame(time=frame.time, values=values, begins=frame.begins))
                self._given.add(row)
            self._pending[row] = []
            if after["done"][row].any():
                ended.add(row)
                self._begins.add(row)
        if self._is_once:
            self.running -= ended
        self._open = set(self.running)
        self._spent += time.monotonic() - start
        return ended


def run_episodes(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    starts: TensorDictBase,
    *,
    make_watch: Callable[[dict[int, int]], Watch],
    max_T: float = math.inf,
    on_step: Callable[[TensorDictBase, set[int]], None] | None = None,
) -> None:
    """Run one episode from each start, all side by side, and watch.

    Args:
        env: made with ``frames_per_action=task.checks_per_action``; what it does at the moment is
            given up. The env of a training that is over will do.
        policy: writes ``action``; a learned one acts greedily.
        starts: ``[E]``, no more than the env has flows.
        make_watch: makes the watch, given the start of each row that has one.
        max_T: after which episodes are left.
        on_step: called after each decision with what the env returned, and the rows it ended.

    Raises:
        ValueError: if there are more starts than flows, or they do not fit the task.
    """
    num_starts, base = starts.shape[0], env.base_env
    if num_starts > base.batch_size[0]:
        raise ValueError(
            f"{num_starts} starts, but the env has {base.batch_size[0]} flows: give no more starts"
        )
    watches: list[Watch] = []

    def begin(start_of: Tensor, state: TensorDictBase) -> None:
        rows = enumerate(start_of.tolist())
        watches.append(make_watch({row: start for row, start in rows if start >= 0}))
        watches[0].keep(base)

    def settle(start_of: Tensor, step: TensorDictBase) -> None:
        ended = watches[0].settle(step)
        if on_step is not None:
            on_step(step, ended)

    episodes.run_episodes(
        env,
        policy,
        starts,
        max_decisions=None if math.isinf(max_T) else math.ceil(max_T / base.task.interval_T - 1e-9),
        on_begin=begin,
        on_step=settle,
        on_frame=lambda start_of, flows: watches[0].look(flows),
    )


class Drawn(NamedTuple):
    """How much was drawn.

    Attributes:
        flows: number of flows.
        frames: of all flows together.
        periods: T, of all flows together.
    """

    flows: int
    frames: int
    periods: float


def draw_episodes(
    env: TransformedEnv,
    policy: Callable[[TensorDictBase], TensorDictBase],
    starts: TensorDictBase,
    *,
    view: TaskView,
    drawing: Drawing,
    flows: list[int],
    frames_per_T: int,
    max_T: float = math.inf,
    on_step: Callable[[TensorDictBase, set[int]], None] | None = None,
) -> Drawn:
    """Run one episode from each start and draw it; see ``run_episodes``.

    Args:
        env: see there.
        policy: see there.
        starts: see there.
        view: of the task.
        drawing: where frames go.
        flows: what the flow of each start is called there.
        frames_per_T: see ``Watch``.
        max_T: see ``run_episodes``.
        on_step: see ``run_episodes``.
    """
    last_T = dict.fromkeys(flows, 0.0)
    num_frames = 0

    def make_watch(start_of: dict[int, int]) -> Watch:
        def give(row: int, frame: Frame) -> None:
            nonlocal num_frames
            flow = flows[start_of[row]]
            drawing.draw(flow, frame)
            last_T[flow] = frame.time
            num_frames += 1

        return Watch(view.task, view.read, rows=start_of, frames_per_T=frames_per_T, give=give)

    run_episodes(env, policy, starts, make_watch=make_watch, max_T=max_T, on_step=on_step)
    return Drawn(len(flows), num_frames, sum(last_T.values()))
