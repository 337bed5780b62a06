"""The environment: B flows with a fish in each, and a task, as one TorchRL ``EnvBase``.

    action --task--> turn, frequency --solver--> n_substeps steps --task--> measurement
           --> observation, terms of the reward, terminated, action mask

This is the only ``EnvBase``; a task supplies everything specific. ``make_env`` adds TorchRL's
transforms.
"""

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from inspect import Signature, signature
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Categorical, Composite
from torchrl.envs import EnvBase
from torchrl.envs.utils import MarlGroupMapType

from fishrl.envs.agents import name_entry
from fishrl.envs.checks import check_answers, check_scene, check_starts_of, check_stream
from fishrl.envs.decision import Decision, merge
from fishrl.envs.draws import MAX_SEED, draw_uniform
from fishrl.envs.flows import Flows
from fishrl.envs.repeating import Repeated
from fishrl.envs.specs import make_specs
from fishrl.envs.task import AbstractTask
from fishrl.physics.fast.checks import check_device
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.settings import checked

logger = logging.getLogger(__name__)


class FlowEnv(EnvBase):
    """A batch of B flows with one fish each, or with M fish each if the task has several.

    With several fish, observations, actions, masks and rewards are ``[B, M, ...]`` under
    ``agents`` (``fishrl.envs.agents``), with ``group_map`` as in TorchRL's multi-agent
    environments. Episodes begin and end for all fish of a flow together.

    A row that terminates within an action keeps the measurement of that moment and does not advance
    to the end of the action (on a GPU its flow continues unread). A row has diverged if it is not
    finite or too fast for the method, if a body has left the grid, or if bodies overlap. It is then
    truncated with reward 0, with ``diverged`` set and with the observation of the last decision; it
    is counted and reset without affecting other rows.

    On a GPU a decision, unless ``on_frame`` is given, and a reset are one graph each from their
    second repetition on: the host waits for a decision once, and refuses an illegal action only
    then. See ``repeating``.

    Args:
        task: the task.
        flows: number of flows B, and how they are computed; all tensors are on their device.
        seed: seed of the starts; each start depends on seed, row and episode only.
        starts: TensorDict ``[E]`` as returned by ``task.sample_starts``. Resets cycle through them,
            in order of rows within one reset. By default each start is drawn at random.
        frames_per_action: calls of ``on_frame`` within an action, at equal intervals: pictures, not
            the env frames of ``total_frames``.
        on_frame: called with this environment, to read ``solver`` and ``measure()``.

    Attributes:
        solver: the flows.
        start: ``[B]`` TensorDict, the start of each row's episode.
        now: ``[B]`` TensorDict, the measurement behind the last observation.
        num_diverged: number of rows that have diverged so far.
        is_resting: ``[B]`` bool, rows that are not advanced and whose output is undefined;
            ``run_episodes`` sets it for rows without a start.
        is_moving: ``[B]`` bool, for ``on_frame``: rows whose episode lasted up to this moment.
        is_ending: ``[B]`` bool, for ``on_frame``: rows whose episode terminates at this moment.
        group_map: TorchRL's map from group to agent names, with several fish.

    Raises:
        ValueError: for invalid arguments, or if a method of the task returns a wrong shape or type.
    """

    def __init__(
        self,
        *,
        task: AbstractTask,
        flows: Flows,
        seed: int = 0,
        starts: TensorDictBase | None = None,
        frames_per_action: int = 1,
        on_frame: Callable[["FlowEnv"], None] | None = None,
    ) -> None:
        check_device(flows.device)
        super().__init__(device=flows.device, batch_size=[flows.num_envs])
        if starts is None:
            check_starts_of(task)
        else:
            task.check_starts(starts)
            starts = starts.to(self.device)
        self.task, self.starts, self.on_frame = task, starts, on_frame
        if task.num_fish > 1:
            names = [f"fish_{number}" for number in range(task.num_fish)]
            self.group_map = MarlGroupMapType.ALL_IN_ONE_GROUP.get_group_map(names)
        self._rows = torch.arange(flows.num_envs, device=self.device)
        self._seed = seed
        self._next_start = torch.zeros_like(self._rows[0])
        self._episode = torch.zeros_like(self._rows)
        self._start_index = torch.full_like(self._rows, -1)
        self.num_diverged = 0
        self.is_resting = torch.zeros_like(self._rows, dtype=torch.bool)
        self.is_moving, self.is_ending = ~self.is_resting, self.is_resting
        self.solver = InPlaceSolver(
            config=task.flow_config(), frequency=1.0 / task.scales.period, **vars(flows)
        )
        self._decision = Decision(
            task,
            self.solver,
            frames_per_action=frames_per_action,
            on_diverged=self._count_diverged,
        )
        self._decide = Repeated(self._decision.run, "a decision")
        self._begin = Repeated(self._begin_rows, "a reset")
        self.start, _ = self._draw_starts(self._give_starts(~self.is_resting))
        task.place_(self.solver, ~self.is_resting, self.start)
        self.now = self._decision.begin(self.start)
        self._make_specs()  # reports an invalid task before the compilation
        self.solver.compile()

    #: Those of ``__init__``, which TorchRL's metaclass would hide.
    __signature__ = Signature([*signature(__init__).parameters.values()][1:])

    def measure(self) -> TensorDict:
        """Measure the current flows; also valid within an action."""
        return self._decision.measure(self.start)

    @contextmanager
    def set_starts(
        self, starts: TensorDictBase, *, on_frame: Callable[["FlowEnv"], None] | None = None
    ) -> Iterator[None]:
        """Use other starts, from the first one, in a ``with`` block; arguments as for the class.

        On exit the previous starts and ``on_frame`` are restored and no row rests; the flows remain
        as they are.
        """
        self.task.check_starts(starts)
        before = self.starts, self._next_start, self.on_frame
        self.starts, self.on_frame = starts.to(self.device), on_frame
        self._next_start = torch.zeros_like(self._next_start)
        try:
            yield
        finally:
            self.starts, self._next_start, self.on_frame = before
            self.is_resting = torch.zeros_like(self.is_resting)

    def _make_specs(self) -> None:
        """Derive the specs from the task and a first measurement."""
        check_stream(self.task, self.solver)
        terms = check_answers(self.task, self.now)
        check_scene(self.task, self.solver, self.start)
        self._no_terms = {name: torch.zeros_like(term) for name, term in terms.items()}
        observation, action, reward = (
            spec.to(self.device) for spec in make_specs(self.task, self.now)
        )
        self.observation_spec_unbatched = observation
        self.full_action_spec_unbatched, self.full_reward_spec_unbatched = action, reward
        flags = ("done", "terminated", "truncated")
        self.done_spec_unbatched = Composite(
            {name: Categorical(2, shape=(1,), dtype=torch.bool) for name in flags}
        ).to(self.device)

    def _give_starts(self, rows: Tensor) -> dict[str, Any]:
        """Return what ``_draw_starts`` reads."""
        return {
            "starts": {} if self.starts is None else self.starts,
            "seed": torch.full_like(self._rows, self._seed & MAX_SEED),
            "next_start": self._next_start,
            "episode": self._episode,
            "rows": rows,
        }

    def _draw_starts(self, given: dict[str, Any]) -> tuple[TensorDict, Tensor]:
        """Return starts ``[B]``, valid in ``rows``, and their indices."""
        starts = given["starts"]
        if not isinstance(starts, TensorDictBase):
            uniform = draw_uniform(given["seed"], self._rows, given["episode"], self.task.num_draws)
            return self.task.starts_from(uniform), torch.full_like(self._rows, -1)
        index = (given["next_start"] + given["rows"].long().cumsum(0) - 1) % starts.shape[0]
        return starts[index], index

    def _begin_rows(self, given: dict[str, Any]) -> tuple[dict[str, Any], None]:
        """Begin episodes in ``rows``; return what follows, by the names of this object."""
        rows, (drawn, index) = given["rows"], self._draw_starts(given)
        start = merge(rows, drawn, given["start"])
        self.task.place_(self.solver, rows, start)
        now = merge(rows, self._decision.begin(start), given["now"])
        flags = ("diverged", "done", "terminated", "truncated")
        none = dict.fromkeys(flags, torch.zeros_like(rows))
        num = max(1, len(given["starts"]))
        after = {
            "start": start,
            "now": now,
            "start_index": torch.where(rows, index, given["start_index"]),
            "episode": given["episode"] + rows,
            "next_start": (given["next_start"] + rows.sum()) % num,
            "written": self._decision.write(now, self._no_terms, **none),
        }
        return after, None

    def _reset(self, tensordict: TensorDictBase | None = None, **kwargs: Any) -> TensorDict:
        rows = torch.ones_like(self._rows, dtype=torch.bool)
        if tensordict is not None and "_reset" in tensordict:
            rows = tensordict["_reset"].reshape(self.batch_size)
        own = {"start": self.start, "now": self.now, "start_index": self._start_index}
        after, _ = self._begin(own | self._give_starts(rows))
        self.start, self.now, self._start_index = (after[name] for name in own)
        self._episode, self._next_start = after["episode"], after["next_start"]
        written: TensorDict = after["written"]
        return written.set("start_index", self._start_index.clone())

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        given = {
            "action": tensordict[name_entry(self.task, "action")],
            "now": self.now,
            "inputs": self._read_inputs(tensordict),
            "start": self.start,
            "is_resting": self.is_resting,
        }
        if self.on_frame is None:
            after, problems = self._decide(given)
        else:  # which may look at anything
            after, problems = self._decision.run(given, self._show_frame)
        self.now = after["now"]
        problems.tell()
        return after["written"].set("start_index", self._start_index.clone())

    def _show_frame(self, is_moving: Tensor, is_ending: Tensor) -> None:
        self.is_moving, self.is_ending = is_moving, is_ending
        if self.on_frame is not None:
            self.on_frame(self)

    def _count_diverged(self, diverged: Tensor) -> None:
        rows = diverged.nonzero().squeeze(-1).tolist()
        self.num_diverged += len(rows)
        meet = " (bodies overlap)" if (diverged & self.solver.overlaps).any() else ""
        several = len(self.solver.config.refined) > 1
        logger.warning(
            "flows %s diverged%s and were truncated; %d so far%s",
            *(rows, meet, self.num_diverged),
            "; bodies whose patches meet need one for both, see list_patches" * several,
        )

    def _read_inputs(self, tensordict: TensorDictBase) -> dict[str, Tensor]:
        """Return the entries that the task reads in addition to the action."""
        names = self._decision.history.inputs
        missing = [name for name in names if name not in tensordict]
        if missing:
            raise ValueError(
                f"{type(self.task).__name__} reads {missing}, which this step's tensordict lacks: "
                "append the transform that writes it (make_env(transforms=[...])), or configure "
                "the task not to read it"
            )
        return {name: tensordict[name].reshape(self.batch_size) for name in names}

    @property
    def seed(self) -> int:
        """Seed of the starts."""
        return self._seed

    @checked
    def _set_seed(self, seed: int | None) -> None:
        """Restart the sequence of starts from ``seed`` (0 if None) at the next reset."""
        self._seed = 0 if seed is None else seed
        self._episode = torch.zeros_like(self._episode)
        self._next_start = torch.zeros_like(self._next_start)

    def get_extra_state(self) -> dict[str, Any]:
        """Return the complete state of flows and episodes, for ``state_dict``."""
        return {
            "solver": self.solver.state_dict(),
            "start": self.start.clone().to_dict(),
            "now": self.now.clone().to_dict(),
            "start_index": self._start_index.clone(),
            "episode": self._episode.clone(),
            "num_diverged": torch.tensor(self.num_diverged),
            "seed": torch.tensor(self._seed & MAX_SEED),
            "next_start": self._next_start.clone(),
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Restore a state, bit for bit."""
        self.solver.load_state_dict(state["solver"])
        for name in ("start", "now"):
            restored = TensorDict(state[name], self.batch_size, device=self.device)
            setattr(self, name, restored.clone())
        for name in ("start_index", "episode", "next_start"):
            setattr(self, f"_{name}", state[name].to(self.device).clone())
        self._seed = int(state["seed"])
        self.num_diverged = int(state["num_diverged"])

    def to(self, device: torch.device | str) -> "FlowEnv":
        """Return the environment; ValueError for another kind of device: flows cannot move."""
        if torch.device(device).type != self.device.type:
            raise ValueError(f"flows on {self.device} cannot move to {device}: make another env")
        return self

    def close(self, *, raise_if_closed: bool = True) -> None:
        """End the solver's processes, if any."""
        super().close(raise_if_closed=raise_if_closed)
        self.solver.close()
