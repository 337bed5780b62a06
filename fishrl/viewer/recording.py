"""Frames of running flows: read within decisions, passed on once their decision is over.

A frame carries the current action and its reward, which is known only at the end of the decision.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain

import torch
from pydantic import PositiveInt
from tensordict import TensorDictBase
from torch import Tensor
from torchrl.envs import TransformedEnv

from fishrl.envs import views
from fishrl.envs.agents import TERM, read_entry
from fishrl.envs.episodes import Episodes, Policy, has_succeeded, name_terms, run_episodes
from fishrl.envs.extensions import HasScene, find_extension, name_flow
from fishrl.envs.flow_env import FlowEnv
from fishrl.envs.scene import Choice, Ending, Frame, Panel, Scene
from fishrl.envs.task import AbstractTask
from fishrl.settings import checked
from fishrl.torch_state import one_thread
from fishrl.viewer.settings import ViewerSettings


@checked
def make_env_scene(
    env: TransformedEnv, view: ViewerSettings = ViewerSettings(), *, policy: str = ""
) -> Scene:
    """Return the scene of a task, without plots of entries that its environment does not output.

    Args:
        env: an environment of ``make_env``.
        view: the field that is drawn, the limit of its colours, and whether levels are shown.
        policy: name of the policy for the title.
    """
    scene: Scene = views.make_scene(env.base_env.task, shows_levels=view.shows_levels)
    num_fish, terms = env.base_env.task.num_fish, name_terms(env)
    if len(terms) > 1:
        series = (views.plot_fish(term, term.removeprefix(TERM), num_fish) for term in terms)
        panel = Panel(
            name="terms of r, as ±log₂(1 + |term|)",
            series=tuple(chain.from_iterable(series)),
            is_step=True,
            is_output=True,
            is_log=True,
        )
        scene = replace(scene, panels=(scene.panels[0], panel, *scene.panels[1:]))
    outputs = {*env.observation_spec.keys(), "action", "reward", *terms}
    panels = tuple(
        panel
        for panel in scene.panels
        if isinstance(panel, Choice)
        or not panel.is_output
        or all(series.key in outputs for series in panel.series)
    )
    title = scene.title + f" · policy: {policy}" * bool(policy)
    scene = replace(scene, title=title, panels=panels)
    return scene.choose_field(view.field, limit=view.field_limit)


@checked
def name_flows(
    task: AbstractTask, flows: Collection[int], starts: TensorDictBase | None = None
) -> dict[int, str]:
    """Return the titles of flows by index; ``starts`` ``[E]`` add the names of labelled streams."""
    names = {flow: "" if starts is None else name_flow(task, starts[flow]) for flow in flows}
    return {flow: f"flow {flow}" + f": {name}" * bool(name) for flow, name in names.items()}


def read_values(
    base: FlowEnv, scene: Scene, rows: Collection[int] | None = None
) -> dict[str, Tensor]:
    """Return the current values ``[B, ...]`` of a scene by key, with the field that it shows.

    The field is read in the flows ``rows``, by default in all; in others it is 0.
    """
    chosen = None
    if rows is not None:
        chosen = torch.zeros(base.batch_size, dtype=torch.bool)
        chosen[list(rows)] = True
    shown = [scene.field.key]
    with one_thread():  # several would wait for each other on a busy machine
        return views.read_scene(base.task, base.solver, base.start, fields=shown, rows=chosen)


def list_reasons(task: AbstractTask, now: TensorDictBase) -> list[str]:
    """Return why the task would end the episode of each row now, such as "caught", or "".

    ``now`` is the measurement ``[B]``.
    """
    named = find_extension(task, HasScene).name_endings(now)
    rows = range(now.batch_size[0])
    return [next((words for words, holds in named.items() if holds[row].any()), "") for row in rows]


def list_endings(
    after: TensorDictBase, task: AbstractTask, reasons: Sequence[str]
) -> list[Ending | None]:
    """Return how the episode of each row ended, None where it continues.

    ``after`` ``[B]`` is the state after a decision; ``reasons`` come from ``list_reasons``.
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
    """Read about ``frames_per_T`` frames per period from some rows of an environment.

    Frames are read at every n-th of the ``task.checks_per_action`` checks for termination in each
    decision. ``give(row, frame)`` receives them in order of time, which starts at 0 in each
    episode.
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
        self._reasons = [""] * base.batch_size[0]  # of ``list_reasons``, at the last frame

    def begin(self, rows: Collection[int]) -> None:
        """Begin an episode in some rows and drop their pending frames."""
        for row in rows:
            self._pending[row], self._last_T[row], self._has_given[row] = [], -1.0, False

    def is_due(self) -> bool:
        """Return whether frames are read at this check; call once per check."""
        self._num_checks += 1
        return self._num_checks % self._stride == 0

    def keep(self, rows: Collection[int]) -> None:
        """Read a frame of some rows; rows that have not advanced since their last are skipped."""
        if not rows:
            return
        base = self._base
        values, solver = read_values(base, self._scene, rows), base.solver
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
        """Pass on the frames of a finished decision, with its action and reward.

        ``step`` ``[B]`` is what ``env.step`` returns. Frames of a diverged row are dropped, except
        the start of its episode.
        """
        after = step["next"]
        rewards = {"reward", *name_terms(self._base)}
        read = {
            name: read_entry(after if name in rewards else step, name)
            for name in self._scene.output_keys | {"reward"}
        }
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


@checked
def record_episodes(
    env: TransformedEnv,
    policy: Policy,
    starts: TensorDictBase,
    *,
    scene: Scene,
    give: Callable[[int, Frame], None],
    frames_per_T: PositiveInt = 8,
    max_decisions: PositiveInt | None = None,
    on_step: Callable[[Tensor, TensorDictBase], None] | None = None,
    on_episodes: Callable[[int], None] | None = None,
) -> Episodes:
    """Run one episode from each start and record it up to the check that ends it.

    Arguments are those of ``run_episodes`` and ``Recorder``, but ``give`` receives the index of the
    start and a frame. The environment needs ``frames_per_action=task.checks_per_action``.
    """
    base = env.base_env
    start_of: dict[int, int] = {}
    recorder = Recorder(
        base, scene, frames_per_T=frames_per_T, give=lambda row, frame: give(start_of[row], frame)
    )

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
    """Return the index of the start of each row, without rows that run none."""
    return {row: start for row, start in enumerate(start_of.tolist()) if start >= 0}


@dataclass(kw_only=True)
class Recording:
    """The frames of one episode, in order of time."""

    scene: Scene
    frames: list[Frame] = field(default_factory=list)

    @property
    def ending(self) -> Ending | None:
        """How the episode ended; None if the recording stops earlier."""
        return self.frames[-1].ending

    @property
    def time(self) -> Tensor:
        """Times of the F frames, T, float64."""
        return torch.tensor([frame.time for frame in self.frames], dtype=torch.float64)

    def stack(self, key: str) -> Tensor:
        """Return the values ``[F, ...]`` of one key of the scene."""
        return torch.stack([frame.values[key] for frame in self.frames])

    def stack_bl(self, key: str) -> Tensor:
        """Return points ``[F, ..., 2]`` (x, y) in body lengths."""
        return self.stack(key).float() / self.scene.body_length
