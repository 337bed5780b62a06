"""Checks of what the methods of a task return, so that errors surface early."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from fishrl.envs.agents import TERM, shape_fish
from fishrl.envs.command import Command
from fishrl.envs.extensions import HasScene, find_extension
from fishrl.envs.sense import count_numbers, read_senses
from fishrl.envs.task import AbstractTask
from fishrl.envs.views import make_scene
from fishrl.physics.bodies.motion import Bending
from fishrl.physics.fast.solver import InPlaceSolver
from fishrl.physics.lattice import MAX_IMPOSED_SPEED

NUM_STARTS = 256
#: Entries of an environment, with its transforms, that no report may replace.
OWN = {
    *("observation", "observation_stack", "critic_observation", "critic_stack", "action_mask"),
    *("action", "agents", "next", "reward", "episode_reward", "step_count", "is_init"),
    *("done", "terminated", "truncated", "diverged", "start_index"),
    *("flow_probabilities", "flow_class"),
}


class Problems:
    """Problems of a decision: a CPU tells them at once, of a GPU the host reads all of them once.

    A graph that repeats the decision writes to the same flags, so that ``tell`` reads its own.
    """

    def __init__(self) -> None:
        self._noted: list[tuple[Tensor, Callable[[], None]]] = []

    def note(self, is_right: Tensor, tell: Callable[[], None]) -> None:
        """Call ``tell``, which raises or logs, unless all of ``is_right`` are true."""
        if is_right.is_cuda:
            self._noted.append((is_right.all(), tell))
        elif not is_right.all():
            tell()

    def tell(self) -> None:
        """Tell what was noted, in order: the one time that the host waits."""
        if self._noted:
            flags, tells = zip(*self._noted, strict=True)
            for is_right, tell in zip(torch.stack(flags).tolist(), tells, strict=True):
                if not is_right:
                    tell()


def check_starts_of(task: AbstractTask) -> None:
    """Raise ValueError unless a sample of a task's random starts is valid."""
    starts = task.sample_starts(NUM_STARTS, torch.Generator().manual_seed(0))
    names = sorted(map(str, starts.keys()))
    expected = "'head' [E, 2] in nodes and 'heading' [E] in radians"
    _require(task, "starts_from", {"head", "heading"} <= set(names), names, expected)
    task.check_starts(starts)


def check_stream(task: AbstractTask, solver: InPlaceSolver) -> None:
    """Raise ValueError for streams faster than the task says, such as one in L / T."""
    config, present = solver.config, float(solver.stream_speed.abs().max())
    fastest = max(config.fastest_edge, replace(config, stream_speed=present).fastest_edge)
    _require(
        task,
        "flow_config",
        fastest <= task.scales.stream_speed * (1.0 + 1e-6),  # float32
        f"a stream of {fastest:.3g} nodes per step, {fastest / task.scales.reference_speed:.3g} "
        "L/T",
        f"at most max_stream_speed_bl = {task.max_stream_speed_bl:g} L/T; stream_speed is in nodes "
        "per step: scales.reference_speed times that in L/T",
    )


def check_scene(task: AbstractTask, solver: InPlaceSolver, starts: TensorDictBase) -> None:
    """Raise ValueError for places to draw of a wrong shape: films follow long after."""
    places = find_extension(task, HasScene).read_scene(solver, starts)
    scene = make_scene(task)
    allowed = {item.key: (3,) for item in scene.curves} | {item.key: (2, 3) for item in scene.marks}
    goal = [] if scene.goal is None else [scene.goal.key]
    single = [item.key for item in scene.trails] + [item.key for item in scene.arrows]
    allowed |= dict.fromkeys(single + goal, (2,))
    allowed |= {arrow.at: (2,) for arrow in scene.arrows if isinstance(arrow.at, str)}
    for key in places.keys() & allowed.keys():
        place, dims = places[key], allowed[key]
        is_right = place.dim() in dims and (len(place), place.shape[-1]) == (len(starts), 2)
        shapes = " or ".join("[B, 2]" if dim == 2 else "[B, N, 2]" for dim in dims)
        _require(task, f"read_scene {key!r}", is_right, place, f"a tensor {shapes}")


def check_answers(task: AbstractTask, now: TensorDictBase) -> dict[str, Tensor]:
    """Return the terms of the reward for no change; raise ValueError for a wrong answer of a task.

    Checked are observation, mask, termination, terms of the reward and report of measurements.
    """
    rows = tuple(now.shape)
    own = shape_fish(task, rows[0])
    _require(task, "n_obs", task.n_obs > 0, task.n_obs, "senses, or n_obs and observe")
    is_own = type(task).observe is not AbstractTask.observe
    got, expected = "an observation besides senses", "one of them; those of a base: senses = ()"
    _require(task, "observe", not (is_own and task.senses), got, expected)
    observed = check_rows(task, "observe", task.observe(now), (*own, task.n_obs), torch.float32)
    is_finite = bool(observed.isfinite().all())
    _require(task, "observe", is_finite, observed.tolist(), "finite numbers")
    if senses := task.critic_senses:
        shape = (*own, count_numbers(senses))
        check_rows(task, "critic_senses", read_senses(senses, now), shape)
    bounds, shape = task.action_bounds, (*own, task.num_actions)
    if bounds is None:
        mask = check_rows(task, "action_mask", task.action_mask(now), shape, torch.bool)
        has_legal = bool(mask.any(-1).all())
        _require(task, "action_mask", has_legal, mask.tolist(), "a legal action in each row")
    else:
        is_right = len(bounds) == task.num_actions and all(a < b for a, b in bounds)
        expected = f"(least, largest) of {task.num_actions} numbers, as num_actions says"
        _require(task, "action_bounds", is_right, bounds, expected)
    check_rows(task, "is_terminated", task.is_terminated(now), rows, torch.bool)
    terms = check_terms(task, task.reward(now, now), own)
    check_rows(task, "count_safe_steps", task.count_safe_steps(now), rows)
    _check_report(task, task.report(now), rows, taken=OWN | {TERM + name for name in terms})
    return terms


def _check_report(task: AbstractTask, report: Any, rows: tuple[int, ...], taken: set[str]) -> None:
    word = task.success
    _require(task, "report", isinstance(report, dict | TensorDictBase), report, "a dict")
    for name, value in report.items():
        is_free = name not in taken | ({"success"} - {word})
        expected = "names that neither the environment nor its metrics use; rename it"
        _require(task, "report", is_free, repr(name), expected)
        is_right = isinstance(value, Tensor) and tuple(value.shape[:1]) == rows
        is_right = is_right and (value.dtype != torch.bool or value.dim() <= 2)
        expected = f"a tensor with {rows[0]} rows, of booleans [B] or [B, n]"
        _require(task, f"report {name!r}", is_right, value, expected)
    if word is not None:
        _require(task, "success", word in report, word, f"an entry of report, {sorted(report)}")
        flag = report[word]
        flag = flag.squeeze(1) if flag.dim() == 2 else flag
        check_rows(task, f"report {word!r}", flag, rows, torch.bool)


def check_rows(
    task: AbstractTask,
    name: str,
    got: Any,
    shape: tuple[int, ...],
    dtype: torch.dtype | None = None,
) -> Tensor:
    """Return the answer of a task's method ``name``; ValueError for another shape or dtype."""
    is_tensor = isinstance(got, Tensor) and tuple(got.shape) == shape
    expected = f"a tensor of shape {shape}" + f", {dtype}" * (dtype is not None)
    _require(task, name, is_tensor and dtype in (None, got.dtype), got, expected)
    tensor: Tensor = got
    return tensor


def check_terms(task: AbstractTask, terms: Any, shape: tuple[int, ...]) -> dict[str, Tensor]:
    """Return the terms of a task's reward; raise ValueError unless each is of this shape."""
    expected = f"named terms, such as {{'progress': ...}}, each a tensor of shape {shape}"
    is_named = isinstance(terms, dict) and terms and all(isinstance(name, str) for name in terms)
    _require(task, "reward", bool(is_named), terms, expected)
    return {n: check_rows(task, f"reward {n!r}", term, shape) for n, term in terms.items()}


def check_command(
    task: AbstractTask, order: Any, rows: tuple[int, ...], problems: Problems
) -> None:
    """Raise ValueError for a wrong output of ``task.command``, in particular wrong units.

    ``rows`` is the shape of its numbers, which ``problems`` notes.
    """
    expected = "Command(turn=..., frequency=...)"
    _require(task, "command", isinstance(order, Command), order, expected)
    bends, motion = isinstance(task.fish.motion, Bending), type(task.fish.motion).__name__
    idle, steers = ("turn", "bend") if bends else ("bend", "turn")
    expected = f"{steers}=..., since the motion of the fish is {motion}"
    _require(task, "command", getattr(order, idle) is None, f"{idle}=...", expected)
    fast = f"nose and tail would move at more than {MAX_IMPOSED_SPEED} nodes per step"
    turn, bend = task.largest_turn, task.largest_bend * (1.0 + 1e-9)
    beats = task.max_frequency / task.scales.period * (1.0 + 1e-9)
    beats_T = f"max_frequency = {task.max_frequency:g} per T"
    limits = {
        "turn": (-turn, turn, f"at most {turn:.3g} radians: {fast}"),
        "bend": (-bend, bend, f"at most {bend:.3g} L: {fast}"),
        "frequency": (0.0, beats, f"0 to {beats:.3g} tail beats per step, which is {beats_T}"),
        "amplitude": (0.0, 1.0, "0 to 1"),
    }
    is_legal: dict[str, Tensor] = {}
    for name, (low, high, _) in limits.items():
        if (value := getattr(order, name)) is not None:
            checked = check_rows(task, f"command {name}", value, rows)
            is_legal[name] = (checked >= low) & (checked <= high)

    def tell() -> None:
        for name, rows_legal in is_legal.items():
            got = getattr(order, name).tolist()
            _require(task, f"command {name}", bool(rows_legal.all()), got, limits[name][2])

    if is_legal:
        problems.note(torch.stack([*is_legal.values()]), tell)


def check_action(action: Tensor, mask: Tensor, problems: Problems) -> Tensor:
    """Return actions as int64; raise ValueError for the first one that its mask forbids.

    The mask is ``[..., num_actions]``. Actions are ``[B]``, or ``[B, M]`` of several fish. On a
    GPU, which does not wait for ``problems``, the first legal ones take the place of illegal ones.
    """
    most = mask.shape[-1] - 1
    if action.shape != mask.shape[:-1] or action.is_floating_point():
        wanted, got = tuple(mask.shape[:-1]), tuple(action.shape)
        raise ValueError(
            f"action of shape {got}, {action.dtype}: must hold integers of shape {wanted}; "
            "make_env(transforms=[OneHotAction()]) takes one-hot actions"
        )
    action = action.long()  # as an index, bytes would be a mask
    is_legal = mask.gather(-1, action.clamp(0, most).unsqueeze(-1)).squeeze(-1)
    is_legal = is_legal & (action >= 0) & (action <= most)

    def tell() -> None:
        index, where = _find_first(~is_legal)
        legal = mask[index].nonzero().squeeze(-1).tolist()
        raise ValueError(
            f"action = {int(action[index])} in {where}: legal is {legal}; policies must "
            "honour 'action_mask', and random actions are legal in environments of make_env"
        )

    problems.note(is_legal, tell)
    return torch.where(is_legal, action, mask.int().argmax(-1)) if action.is_cuda else action


def scale_action(
    action: Tensor, bounds: Sequence[tuple[float, float]], problems: Problems
) -> Tensor:
    """Map actions ``[B, n]`` in [-1, 1] to the ``bounds`` of their n numbers, float64.

    Those of several fish are ``[B, M, n]``.

    Raises:
        ValueError: naming the first row with another shape or with a number beyond [-1, 1].
    """
    if action.dim() < 2 or action.shape[-1] != len(bounds):
        raise ValueError(
            f"action of shape {tuple(action.shape)}: must hold {len(bounds)} numbers in each row"
        )
    is_legal = (action.abs() <= 1.0).all(-1)

    def tell() -> None:
        index, where = _find_first(~is_legal)
        raise ValueError(f"action = {action[index].tolist()} in {where}: allowed is -1 to 1")

    problems.note(is_legal, tell)
    columns = zip(action.double().unbind(-1), bounds, strict=True)
    return torch.stack([a + 0.5 * (value + 1.0) * (b - a) for value, (a, b) in columns], -1)


def _find_first(is_wrong: Tensor) -> tuple[tuple[int, ...], str]:
    """Return index and name of the first of ``[B]`` rows, or ``[B, M]`` fish, that is wrong."""
    index = tuple(is_wrong.nonzero()[0].tolist())
    return index, ", ".join(f"{of} {i}" for of, i in zip(("row", "fish"), index, strict=False))


def _require(task: AbstractTask, name: str, is_right: bool, got: Any, expected: str) -> None:
    if not is_right:
        if isinstance(got, Tensor):
            got = f"a tensor of shape {tuple(got.shape)}, {got.dtype}"
        raise ValueError(f"{type(task).__name__}.{name} gives {got}, expected {expected}")
