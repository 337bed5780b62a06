"""The environment: B flows, each with a fish, and a task, as one TorchRL ``EnvBase``.

    action --task--> turn, frequency --solver--> n_substeps steps --task--> measurement
           --> observation, reward, ends, mask

It is the only ``EnvBase`` here; tasks differ, the habitat does not. ``make_env`` adds TorchRL's
transforms: frame stacking, time limit, action mask.
"""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Binary, Categorical, Composite, Unbounded
from torchrl.envs import (
    ActionMask,
    CatFrames,
    EnvBase,
    InitTracker,
    RewardSum,
    StepCounter,
    Transform,
    TransformedEnv,
)

from fishrl.envs.checks import (
    check_action,
    check_answers,
    check_command,
    check_rows,
    check_starts_of,
)
from fishrl.envs.draws import draw_uniform
from fishrl.envs.schedule import make_schedule
from fishrl.envs.task import AbstractTask

logger = logging.getLogger(__name__)


class FlowEnv(EnvBase):
    """Flows side by side, one fish each, all advancing together.

    A row that ends within an action keeps the measurement of that moment and need not run on to the
    end of the action. A row that diverges (not finite, too fast for the method, the fish out of
    the grid) is truncated with reward 0, ``diverged`` set and the last decision's observation; it
    is counted, reset like any other, and never touches its neighbours.

    Args:
        task: what the fish has to do.
        num_envs: number of flows B.
        seed: of the starts; what a row draws depends on seed, row and episode alone.
        device: where everything lives.
        compile_flow: compile the flow step; otherwise it runs eagerly, about 10 times slower.
            (TorchRL takes the keyword ``compile`` of every environment class for itself.)
        starts: TensorDict ``[E]`` as ``task.sample_starts`` returns; resets take them in order, in
            order of rows within one reset, over and over. By default each start is drawn.
        frames_per_action: how often ``on_frame`` is called within an action, at equal distances.
        on_frame: called with this environment, to look at ``solver`` and ``measure()``.

    Attributes:
        solver: the flows.
        start: ``[B]`` TensorDict, where each row's episode began.
        now: ``[B]`` TensorDict, the measurement that the last observation was made of.
        is_resting: ``[B]`` bool, rows whose flow stands still, as nobody needs them any more; what
            they report is undefined. ``run_episodes`` sets it for rows without a start.

    Raises:
        ValueError: if ``num_envs``, ``frames_per_action``, ``starts`` or what the task answers
            cannot be.
    """

    def __init__(
        self,
        *,
        task: AbstractTask,
        num_envs: int,
        seed: int = 0,
        device: torch.device | str = "cpu",
        compile_flow: bool = True,
        starts: TensorDictBase | None = None,
        frames_per_action: int = 1,
        on_frame: Callable[["FlowEnv"], None] | None = None,
    ) -> None:
        if num_envs < 1:
            raise ValueError(f"num_envs = {num_envs}: at least one flow is needed")
        super().__init__(device=device, batch_size=[num_envs])
        if starts is None:
            check_starts_of(task)
        else:
            task.check_starts(starts)
            starts = starts.to(self.device)
        self.task, self.starts, self.on_frame = task, starts, on_frame
        self._schedule = make_schedule(
            task.n_substeps,
            checks=task.checks_per_action,
            frames=frames_per_action,
            samples=task.num_samples,
        )
        self._rows = torch.arange(num_envs, device=self.device)
        self._seed, self._next_start = seed, 0
        self._episode = torch.zeros_like(self._rows)
        self._start_index = torch.full_like(self._rows, -1)
        self._num_diverged = torch.zeros((), dtype=torch.int64, device=self.device)
        self.is_resting = torch.zeros_like(self._rows, dtype=torch.bool)
        self.solver = task.make_solver(num_envs=num_envs, device=self.device, compile=compile_flow)
        self.solver.compile()
        every_row = torch.ones_like(self._rows, dtype=torch.bool)
        self.start, _ = self._draw_starts(every_row)
        self._next_start = 0
        task.place_(self.solver, every_row, self.start)
        self.now = self._begin()
        self._make_specs()

    @property
    def num_diverged(self) -> int:
        """Number of rows that have diverged so far."""
        return int(self._num_diverged)

    def measure(self) -> TensorDict:
        """Measure the flows as they are, within an action too."""
        return self.task.measure(self.solver, self.start)

    @contextmanager
    def set_starts(
        self, starts: TensorDictBase, *, on_frame: Callable[["FlowEnv"], None] | None = None
    ) -> Iterator[None]:
        """Take other starts within a ``with``, from the first on; for the arguments see the class.

        Afterwards starts and ``on_frame`` are the former ones and no row rests; the flows are not
        restored.
        """
        self.task.check_starts(starts)
        before = self.starts, self._next_start, self.on_frame
        self.starts, self._next_start, self.on_frame = starts.to(self.device), 0, on_frame
        try:
            yield
        finally:
            self.starts, self._next_start, self.on_frame = before
            self.is_resting = torch.zeros_like(self.is_resting)

    def _begin(self) -> TensorDict:
        """Measure as at the beginning of an episode: with one sample, and nothing remembered."""
        now = self.measure()
        if self.task.num_samples:
            now.update(_repeat(self._sense(), self.task.num_samples))
        return now.update(self.task.begin(now))

    def _sense(self) -> TensorDict:
        return TensorDict(
            self.task.sense(self.solver, self.start), self.batch_size, device=self.device
        )

    def _make_specs(self) -> None:
        """Derive the specs from what the task says about a first measurement."""
        task = self.task
        check_answers(task, self.now)
        reported = {
            name: Binary(shape[-1], shape=shape, dtype=torch.bool)
            if value.dtype == torch.bool
            else Unbounded(shape, dtype=value.dtype)
            for name, value in task.report(self.now).items()
            for shape in [tuple(value.shape[1:]) or (1,)]
        }
        self.observation_spec_unbatched = Composite(
            observation=Unbounded((task.n_obs,)),
            action_mask=Binary(task.num_actions, dtype=torch.bool),
            diverged=Binary(1, dtype=torch.bool),
            start_index=Unbounded((), dtype=torch.int64),
            **reported,
            device=self.device,
        )
        self.action_spec_unbatched = Categorical(task.num_actions, device=self.device)
        self.reward_spec_unbatched = Unbounded((1,), device=self.device)
        flags = ("done", "terminated", "truncated")
        self.done_spec_unbatched = Composite(
            {name: Categorical(2, shape=(1,), dtype=torch.bool) for name in flags},
            device=self.device,
        )

    def _draw_starts(self, rows: Tensor) -> tuple[TensorDict, Tensor]:
        """Return starts ``[B]``, of which those of ``rows`` will be used, and their indices."""
        if self.starts is None:
            uniform = draw_uniform(self._seed, self._rows, self._episode, self.task.num_draws)
            return self.task.starts_from(uniform), torch.full_like(self._rows, -1)
        index = (self._next_start + rows.long().cumsum(0) - 1) % self.starts.shape[0]
        self._next_start = (self._next_start + int(rows.sum())) % self.starts.shape[0]
        return self.starts[index], index

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        rows = torch.ones_like(self._rows, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(self.batch_size)
        drawn, index = self._draw_starts(rows)
        self.start = _merge(rows, drawn, self.start)
        self._start_index = torch.where(rows, index, self._start_index)
        self._episode = self._episode + rows
        self.task.place_(self.solver, rows, self.start)
        self.now = _merge(rows, self._begin(), self.now)
        none = torch.zeros_like(rows)
        return self._write(diverged=none, done=none, terminated=none, truncated=none)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        action = tensordict["action"]
        check_action(action, self.task.action_mask(self.now))
        before = self.now.copy().update(self._read_inputs(tensordict))
        order, rows = self.task.command(action, before), tuple(self.batch_size)
        check_command(self.task, order, rows)
        self.solver.command_(order.turn, self.task.n_substeps, order.frequency)
        now, diverged = self._advance(before)
        now.update(self.task.remember(before, action, now))
        self.now = _merge(~diverged, now, self.now)
        self._count(diverged)
        terminated = self.task.is_terminated(self.now) & ~diverged
        earned = check_rows(self.task, "reward", self.task.reward(before, self.now), rows, None)
        reward = earned.float().masked_fill(diverged, 0.0)
        result = self._write(
            diverged=diverged,
            done=terminated | diverged,
            terminated=terminated,
            truncated=diverged,
        )
        return result.set("reward", reward.unsqueeze(-1))

    def _advance(self, before: TensorDict) -> tuple[TensorDict, Tensor]:
        """Run the flows for one action.

        Returns:
            Each row's measurement at its end, or at the end of the action, with what was sensed on
            the way; nothing to rely on in diverged rows. And ``[B]``, which rows diverged.
        """
        now, diverged = before, torch.zeros_like(self._rows, dtype=torch.bool)
        is_decided = self.is_resting
        samples: list[TensorDict] = []
        felt_at_end: TensorDict | None = None  # by rows that end before the first sample
        for stretch in self._schedule:
            self.solver.advance_(stretch.num_steps, ~is_decided)
            if stretch.is_sample:
                sensed = self._sense()
                kept = samples[-1] if samples else felt_at_end
                samples.append(sensed if kept is None else _merge(is_decided, kept, sensed))
            if stretch.is_check:
                seen = self.measure()
                is_ending = self.task.is_terminated(seen) | stretch.is_last
                is_new = is_ending & ~is_decided
                if is_new.any():
                    # Reading whole flows is dear: do it when a row's outcome hangs on it.
                    diverged = diverged | is_new & self.solver.is_diverged()
                    now = _merge(is_new, seen, now.select(*seen.keys()))
                    is_decided = is_decided | is_new
                    if self.task.num_samples and not samples:
                        sensed = self._sense()
                        kept = sensed if felt_at_end is None else felt_at_end
                        felt_at_end = _merge(is_new, sensed, kept)
            if stretch.is_frame and self.on_frame is not None:
                self.on_frame(self)
        return now.update(torch.stack(samples, 1)) if samples else now, diverged

    def _count(self, diverged: Tensor) -> None:
        if diverged.any():
            self._num_diverged += diverged.sum()
            rows = diverged.nonzero().squeeze(-1).tolist()
            logger.warning("flows %s diverged and end here; %d so far", rows, self.num_diverged)

    def _read_inputs(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return what the task wants of the brain's side beside the action."""
        missing = [name for name in self.task.inputs if name not in tensordict]
        if missing:
            raise ValueError(
                f"{type(self.task).__name__} reads {missing}, and the tensordict of this step has "
                "no such entry: append the transform that writes it (make_env(transforms=[...])), "
                "or set the task up to do without"
            )
        return {name: tensordict[name].reshape(self.batch_size) for name in self.task.inputs}

    def _write(self, **flags: Tensor) -> TensorDict:
        """Return everything there is to see, with flags ``[B]`` as columns."""
        columns = {**self.task.report(self.now), **flags}
        return TensorDict(
            {
                "observation": self.task.observe(self.now),
                "action_mask": self.task.action_mask(self.now),
                "start_index": self._start_index.clone(),
                **{
                    name: (value.unsqueeze(-1) if value.dim() == 1 else value).clone()
                    for name, value in columns.items()
                },
            },
            self.batch_size,
            device=self.device,
        )

    def _set_seed(self, seed: int | None) -> None:
        """Begin anew with the starts of ``seed`` (0 if None) or the given ones, at later resets."""
        self._seed = 0 if seed is None else seed
        self._episode, self._next_start = torch.zeros_like(self._episode), 0

    def get_extra_state(self) -> dict[str, Any]:
        """Return everything that the future depends on, for ``state_dict``."""
        return {
            "solver": self.solver.state_dict(),
            "start": self.start.clone().to_dict(),
            "now": self.now.clone().to_dict(),
            "start_index": self._start_index.clone(),
            "episode": self._episode.clone(),
            "num_diverged": self._num_diverged.clone(),
            "seed": torch.tensor(self._seed),
            "next_start": torch.tensor(self._next_start),
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore what ``state_dict`` returned, exactly."""
        self.solver.load_state_dict(state["solver"])
        for name in ("start", "now"):
            restored = TensorDict(state[name], self.batch_size, device=self.device)
            setattr(self, name, restored.clone())
        for name in ("start_index", "episode", "num_diverged"):
            setattr(self, f"_{name}", state[name].to(self.device).clone())
        self._seed, self._next_start = int(state["seed"]), int(state["next_start"])

    def to(self, device: torch.device | str) -> "FlowEnv":
        """Return itself: flows do not move to another device.

        Raises:
            ValueError: if ``device`` is of another kind.
        """
        if torch.device(device).type != self.device.type:
            raise ValueError(
                f"the flows live on {self.device} and cannot move to {device}: make the "
                f"environment with device={str(device)!r}"
            )
        return self

    def close(self, *, raise_if_closed: bool = True) -> None:
        """End the solver's processes, if any."""
        super().close(raise_if_closed=raise_if_closed)
        self.solver.close()


def make_env(
    *,
    task: AbstractTask,
    num_envs: int,
    seed: int = 0,
    device: torch.device | str = "cpu",
    compile: bool = True,
    starts: TensorDictBase | None = None,
    frames_per_action: int = 1,
    on_frame: Callable[[FlowEnv], None] | None = None,
    transforms: Sequence[Transform] = (),
) -> TransformedEnv:
    """Return the environment as a brain sees it; for the arguments see ``FlowEnv``.

    Beside the keys of ``FlowEnv`` there are ``observation_stack`` ``[B, num_stacked * n_obs]``,
    oldest first (the first observation fills it at reset), ``is_init``, ``step_count`` and
    ``episode_reward``; an episode is truncated after ``task.time_limit`` decisions, and random
    actions are legal ones. ``transforms`` of one's own come before the frames are stacked and may
    lengthen ``observation``.
    """
    env = TransformedEnv(
        FlowEnv(
            task=task,
            num_envs=num_envs,
            seed=seed,
            device=device,
            compile_flow=compile,
            starts=starts,
            frames_per_action=frames_per_action,
            on_frame=on_frame,
        )
    )
    for transform in (
        InitTracker(),
        StepCounter(max_steps=task.time_limit),
        RewardSum(),
        *transforms,
        CatFrames(
            N=task.num_stacked, dim=-1, in_keys=["observation"], out_keys=["observation_stack"]
        ),
        ActionMask(),
    ):
        env.append_transform(transform)
    return env


def _repeat(sample: TensorDictBase, num: int) -> TensorDict:
    """Return ``num`` times the same sample ``[B, ...]``, as ``[B, num, ...]``."""
    return sample.apply(lambda t: t.unsqueeze(1).expand(-1, num, *t.shape[1:]))


def _merge(rows: Tensor, new: TensorDictBase, old: TensorDictBase) -> TensorDict:
    """Return ``new`` in ``rows`` ``[B]`` and ``old`` elsewhere."""
    return old.apply(
        lambda kept, fresh: torch.where(rows.view(-1, *(1,) * (kept.dim() - 1)), fresh, kept),
        new,
    )
