"""Frames of running flows: read within decisions, passed on once their decision is over.

A frame carries the action in force and its reward, which is known only at the decision's end.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace

import torch
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs import views
from fishrl.envs.agents import read_entry
from fishrl.envs.episodes import Episodes, Policy, has_succeeded, run_episodes
from fishrl.envs.extensions import HasScene, find_extension, name_flow
from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.scene import Choice, Ending, Frame, Scene
from fishrl.envs.task import AbstractTask


def make_scene(
    env: TransformedEnv,
    *,
    field: str = "vorticity",
    field_limit: float | None = None,
    policy: str = "",
) -> Scene:
    """Return the scene of an env's task, with the plots of those outputs that the env has.

    ``field`` is drawn; its colours saturate at ``field_limit``, by default the field's own limit.
    The title ends with the name of the ``policy``, if given.

    Raises:
        ValueError: for a field that the scene does not have.
    """
    scene: Scene = views.make_scene(env.base_env.task)
    outputs = {*env.observation_spec.keys(), "action", "reward"}
    panels = tuple(
        panel
        for panel in scene.panels
        if isinstance(panel, Choice)
        or not panel.is_output
        or all(series.key in outputs for series in panel.series)
    )
    title = scene.title + f" · policy: {policy}" * bool(policy)
    return replace(scene, title=title, panels=panels).choose_field(field, limit=field_limit)


def name_flows(
    task: AbstractTask, flows: Collection[int], starts: TensorDictBase | None = None
) -> dict[int, str]:
    """Return titles of flows by their index, from the starts ``[E]`` they begin with, if known."""
    names = {flow: "" if starts is None else name_flow(task, starts[flow]) for flow in flows}
    return {flow: f"flow {flow}" + f": {name}" * bool(name) for flow, name in names.items()}


def read_values(base: FlowEnv, scene: Scene) -> dict[str, Tensor]:
    """Return what the scene of an env shows now, ``[B, ...]``; of its fields only the first."""
    hidden = {field.key for field in scene.fields[1:]}
    values = views.read_scene(base.task, base.solver, base.start)
    return {key: value for key, value in values.items() if key not in hidden}


def list_reasons(task: AbstractTask, now: TensorDictBase) -> list[str]:
    """Return in what words each row's episode ends, if the task ends it ``now``; or nothing."""
    ways = find_extension(task, HasScene).name_endings(now)
    rows = range(now.batch_size[0])
    return [next((words for words, is_so in ways.items() if is_so[row].any()), "") for row in rows]


def list_endings(
    after: TensorDictBase, task: AbstractTask, reasons: Sequence[str]
) -> list[Ending | None]:
    """Return how each row's episode ended with this decision, None where it goes on.

    ``after`` ``[B]`` is the state at its end, ``reasons`` are those of ``list_reasons``.
    """
    is_success, endings = has_succeeded(after, task.success), list[Ending | None]()
    for row, reason in enumerate(reasons):
        has_won = bool(is_success[row].any())
        words = "lasted to the time limit" if has_won else "time is over"
        if after["terminated"][row].any():
            words = reason or ("success" if has_won else "ended by the task")
        if after["diverged"][row].any():
            words = "the flow diverged"
        is_over = bool(after["done"][row].any())
        endings.append(Ending(words=words, is_success=has_won) if is_over else None)
    return endings


class Recorder:
    """Reads about ``frames_per_T`` frames per period of some rows of an env.

    Termination is checked ``task.checks_per_action`` times per decision; a frame is read at every
    n-th check. ``give`` is called with row and frame, in the order of time; times begin at 0 in
    each episode.
    """

    def __init__(
        self,
        base: FlowEnv,
        scene: Scene,
        *,
        frames_per_T: int,
        give: Callable[[int, Frame], None],
    ) -> None:
        if frames_per_T < 1:
            raise ValueError(f"frames_per_T = {frames_per_T}: must be at least 1")
        self._base, self._scene, self._give = base, scene, give
        checks_per_T = base.task.checks_per_action / base.task.interval_T
        self._stride = max(1, round(checks_per_T / frames_per_T))
        self._num_checks = 0
        self._pending: dict[int, list[Frame]] = {}
        self._last_T: dict[int, float] = {}
        self._has_given: dict[int, bool] = {}
        self._reasons = [""] * base.batch_size[0]  # of the end, should the episodes end here

    def begin(self, rows: Collection[int]) -> None:
        """Begin an episode in some rows; frames of theirs that are pending are dropped."""
        for row in rows:
            self._pending[row], self._last_T[row], self._has_given[row] = [], -1.0, False

    def is_due(self) -> bool:
        """Return whether to read frames at this check; call it once per check."""
        self._num_checks += 1
        return self._num_checks % self._stride == 0

    def keep(self, rows: Collection[int]) -> None:
        """Read a frame of some rows; those that have not moved since the last one are left out."""
        if not rows:
            return
        base = self._base
        values, solver = read_values(base, self._scene), base.solver
        reasons = list_reasons(base.task, base.measure())
        ages, period = solver.body.age.tolist(), base.task.scales.period
        for row in rows:
            time, last = ages[row] / period, self._last_T[row]
            if time != last:
                frame = Frame(
                    time=time,
                    values={name: value[row].cpu().clone() for name, value in values.items()},
                    begins=last < 0.0 or time < last,
                )
                self._pending[row].append(frame)
                self._last_T[row] = time
                self._reasons[row] = reasons[row]

    def settle(self, step: TensorDictBase, rows: Collection[int]) -> None:
        """Give the frames of a decision that is over, with its action and reward.

        ``step`` ``[B]`` is as the env returns it. Of a row that diverged nothing is given but, at
        the very first decision, the start.
        """
        after = step["next"]
        read = {name: read_entry(step, name) for name in self._scene.output_keys}
        read["reward"] = read_entry(after, "reward")
        endings = list_endings(after, self._base.task, self._reasons)
        for row in rows:
            outputs = {name: value[row].cpu() for name, value in read.items() if value is not None}
            outputs["reward"] = outputs["reward"].sum(-1)
            frames, self._pending[row] = self._pending[row], []
            if after["diverged"][row].any():
                frames = [] if self._has_given[row] else frames[:1]
            for number, frame in enumerate(frames, 1):
                last = endings[row] if number == len(frames) else None
                values = {**outputs, **frame.values}
                self._give(row, replace(frame, values=values, ending=last))
                self._has_given[row] = True


def record_episodes(
    env: TransformedEnv,
    policy: Policy,
    starts: TensorDictBase,
    *,
    scene: Scene,
    give: Callable[[int, Frame], None],
    frames_per_T: int = 8,
    max_decisions: int | None = None,
    on_step: Callable[[Tensor, TensorDictBase], None] | None = None,
    on_episodes: Callable[[int], None] | None = None,
) -> Episodes:
    """Run one episode from each start and record it, from its start to the check that ends it.

    Arguments are as for ``run_episodes`` and ``Recorder``, but ``give`` is called with the number
    of the start and a frame, in the order of time. Make the env with
    ``frames_per_action=task.checks_per_action``.
    """
    base = env.base_env
    start_of: dict[int, int] = {}

    def pass_on(row: int, frame: Frame) -> None:
        give(start_of[row], frame)

    recorder = Recorder(base, scene, frames_per_T=frames_per_T, give=pass_on)

    def begin(begun: Tensor, state: TensorDictBase) -> None:
        rows = _list_rows(begun)
        start_of.update(rows)
        recorder.begin(rows)
        recorder.keep(rows)

    def keep(running: Tensor, flows: FlowEnv) -> None:
        shown = running if recorder.is_due() else running.masked_fill(~flows.is_ending, -1)
        recorder.keep(_list_rows(shown))

    def settle(running: Tensor, step: TensorDictBase) -> None:
        recorder.settle(step, _list_rows(running))
        if on_step is not None:
            on_step(running, step)

    return run_episodes(
        env,
        policy,
        starts,
        max_decisions=max_decisions,
        on_begin=begin,
        on_step=settle,
        on_frame=keep,
        on_episodes=on_episodes,
    )


def _list_rows(start_of: Tensor) -> dict[int, int]:
    """Return the start of each row that has one."""
    return {row: start for row, start in enumerate(start_of.tolist()) if start >= 0}


@dataclass(kw_only=True)
class Recording:
    """The frames of one episode, in the order of time."""

    scene: Scene
    frames: list[Frame] = field(default_factory=list)

    @property
    def ending(self) -> Ending | None:
        """How the episode ended; None if it was cut."""
        return self.frames[-1].ending

    @property
    def time(self) -> Tensor:
        """``[F]`` in T, float64."""
        return torch.tensor([frame.time for frame in self.frames], dtype=torch.float64)

    def stack(self, key: str) -> Tensor:
        """Return ``[F, ...]`` what the frames hold under a key of the scene."""
        return torch.stack([frame.values[key] for frame in self.frames])

    def stack_bl(self, key: str) -> Tensor:
        """Return places ``[F, ..., 2]`` (x, y) in body lengths."""
        return self.stack(key).float() / self.scene.body_length
