"""Checks of what the methods of a task return, so that errors surface early."""

from math import pi
from typing import TYPE_CHECKING, Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

if TYPE_CHECKING:
    from fishrl.envs.task import AbstractTask

MAX_TURN = 2.0 * pi  # radians in one control interval
MAX_FREQUENCY = 0.1  # tail beats per step: ten steps for a beat
NUM_STARTS = 256


def check_starts_of(task: "AbstractTask") -> None:
    """Check that a sample of a task's random starts is valid.

    Raises:
        ValueError: naming the first invalid start.
    """
    starts = task.sample_starts(NUM_STARTS, torch.Generator().manual_seed(0))
    for name in ("head", "heading"):
        if name not in starts:
            raise ValueError(
                f"{_name(task)}.starts_from gives {sorted(map(str, starts.keys()))}: it must give "
                "'head' [E, 2] in nodes and 'heading' [E] in radians"
            )
    task.check_starts(starts)


def check_answers(task: "AbstractTask", now: TensorDictBase) -> None:
    """Check observation, mask, termination and report of a first measurement ``[B]``.

    Raises:
        ValueError: naming the method, its output and the expected one.
    """
    rows = tuple(now.shape)
    sizes = "make it agree with n_obs and num_actions"
    observed = check_rows(
        task, "observe", task.observe(now), (*rows, task.n_obs), torch.float32, sizes
    )
    if not observed.isfinite().all():
        raise ValueError(f"{_name(task)}.observe gives {observed.tolist()}: it must be finite")
    mask = check_rows(
        task, "action_mask", task.action_mask(now), (*rows, task.num_actions), torch.bool, sizes
    )
    if not mask.any(-1).all():
        raise ValueError(f"{_name(task)}.action_mask has a row without any legal action")
    check_rows(task, "is_terminated", task.is_terminated(now), rows, torch.bool)
    _check_report(task, task.report(now), rows)


def _check_report(task: "AbstractTask", report: Any, rows: tuple[int, ...]) -> None:
    if not isinstance(report, dict | TensorDictBase):
        raise ValueError(
            f"{_name(task)}.report gives {_describe(report)}: expected a dict of tensors [B, ...]"
        )
    for name, value in report.items():
        if not isinstance(value, Tensor) or tuple(value.shape[:1]) != rows:
            raise ValueError(
                f"{_name(task)}.report gives {name!r} = {_describe(value)}: expected a tensor "
                f"with {rows[0]} rows"
            )
    word = task.success
    if word in report:
        flag = report[word]
        column = flag.squeeze(1) if flag.dim() == 2 else flag
        check_rows(task, f"report()[{word!r}]", column, rows, torch.bool)
    elif word != "survived":
        raise ValueError(
            f"{_name(task)}.success = {word!r}, but report gives {sorted(report)}: let it give "
            f"{word!r} [B] bool, or remove success if reaching the time limit is success"
        )


def check_rows(
    task: "AbstractTask",
    name: str,
    got: Any,
    shape: tuple[int, ...],
    dtype: torch.dtype | None,
    hint: str = "a row for each flow",
) -> Tensor:
    """Return what a task's method ``name`` gave, after checking its shape and dtype (None: any).

    Raises:
        ValueError: if it differs; ``hint`` is the remedy for a wrong shape.
    """
    if not isinstance(got, Tensor):
        raise ValueError(f"{_name(task)}.{name} gives {_describe(got)}, expected a tensor {shape}")
    if tuple(got.shape) != shape:
        raise ValueError(
            f"{_name(task)}.{name} gives shape {tuple(got.shape)}, expected {shape}: {hint}"
        )
    if dtype is not None and got.dtype != dtype:
        raise ValueError(f"{_name(task)}.{name} gives {got.dtype}, expected {dtype}")
    return got


def check_command(task: "AbstractTask", order: Any, rows: tuple[int, ...]) -> None:
    """Check the output ``order`` of ``task.command`` for rows ``(B,)``, in particular its units.

    Raises:
        ValueError: if it is no ``Command``, or a value is out of range.
    """
    turn, frequency = getattr(order, "turn", None), getattr(order, "frequency", None)
    if turn is None:
        raise ValueError(
            f"{_name(task)}.command gives {_describe(order)}: expected Command(turn=..., "
            "frequency=...)"
        )
    check_rows(task, "command().turn", turn, rows, None)
    if not (turn.abs() <= MAX_TURN).all():
        raise ValueError(
            f"{_name(task)}.command turns by {turn.tolist()}: expected radians, at most 2 pi"
        )
    if frequency is None:
        return
    check_rows(task, "command().frequency", frequency, rows, None)
    if not ((frequency >= 0.0) & (frequency <= MAX_FREQUENCY)).all():
        raise ValueError(
            f"{_name(task)}.command asks for frequencies {frequency.tolist()}: expected tail beats "
            f"per step, 0 to {MAX_FREQUENCY}; n beats per T are n / self.scales.period"
        )


def check_action(action: Tensor, mask: Tensor) -> None:
    """Check that actions ``[B]`` are legal by the mask ``[B, num_actions]``.

    Raises:
        ValueError: naming the first row with an illegal action.
    """
    most = mask.shape[-1] - 1
    is_legal = mask.gather(-1, action.clamp(0, most).unsqueeze(-1)).squeeze(-1)
    is_legal = is_legal & (action >= 0) & (action <= most)
    if not is_legal.all():
        row = int(is_legal.int().argmin())
        legal = mask[row].nonzero().squeeze(-1).tolist()
        raise ValueError(
            f"action = {int(action[row])} in row {row}: legal is {legal}; policies must "
            "honour 'action_mask', and random actions are legal in environments of make_env"
        )


def _name(task: "AbstractTask") -> str:
    return type(task).__name__


def _describe(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"a tensor of shape {tuple(value.shape)}"
    return f"{type(value).__name__} {value!r}"
