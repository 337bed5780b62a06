"""Where a batch of flows lies and advances: in this process, or in one process per core."""

import logging
import time
from collections.abc import Collection, Sequence
from contextlib import AbstractContextManager, nullcontext

import torch
from torch import Tensor

from fishrl.limits import count_cores
from fishrl.physics.fast.batch import FlowBatch
from fishrl.physics.fast.inductor import find_compiler_problem
from fishrl.physics.fast.workers import (
    SharedMemory,
    Workers,
    can_send,
    compiling_aside,
    open_shared,
)
from fishrl.physics.flow import FlowConfig
from fishrl.torch_state import one_thread

logger = logging.getLogger(__name__)


class Execution:
    """A batch of flows and the processes that advance it; arguments as of ``InPlaceSolver``.

    Attributes:
        batch: the flows; with workers, in memory shared with them.
        group_size: flows per group.
        num_workers: additional processes.
        workers: those processes, once they are ready.
    """

    def __init__(
        self,
        configs: Sequence[FlowConfig],
        *,
        device: torch.device,
        compile: bool,
        num_workers: int | None,
        flows_per_launch: int | None,
    ) -> None:
        num_envs, is_cpu = len(configs), device.type == "cpu"
        self.group_size = flows_per_launch or (1 if is_cpu else num_envs)
        if self.group_size < 1 or num_envs % self.group_size:
            raise ValueError(
                f"flows_per_launch = {flows_per_launch}: must divide the number of flows {num_envs}"
            )
        num_groups, can_share = num_envs // self.group_size, is_cpu and can_send(configs)
        self._is_alone = False
        if num_workers is None:
            is_compiled = can_share and compile and not find_compiler_problem("cpu")
            num_workers = min(count_cores(), num_groups) if is_compiled else 0
            if num_workers == 1:  # it would take seconds to start, and this process wait for it
                self._is_alone, num_workers = True, 0
        if num_workers < 0 or (num_workers and not can_share):
            raise ValueError(
                f"num_workers = {num_workers} on {device}: must be 0 on a GPU; on a CPU, workers "
                "need Linux or macOS, and each class of the configuration in a module, not in a "
                "script or function"
            )
        self.num_workers = min(num_workers, num_groups)
        self.workers: Workers | None = None
        self._configs, self._device, self._wants_compile = configs, device, compile
        self._is_ready, self._end = False, ""  # why it cannot advance
        self._shared = open_shared() if self.num_workers else None
        self.batch = FlowBatch(
            configs,
            group_size=self.group_size,
            device=device,
            allocate=SharedMemory(self._shared.fileno()) if self._shared else self._allocate,
        )

    def _allocate(self, num_bytes: int) -> Tensor:
        return torch.zeros(num_bytes, dtype=torch.uint8, device=self._device)

    def compile(self) -> None:
        """Compile the step and start the workers, once."""
        if self._is_ready or not (self.num_workers or self._wants_compile):
            return
        began = time.perf_counter()
        with one_thread() if self.num_workers else self._limit_threads():
            is_new = self._wants_compile and self.batch.is_new()
        level = logging.WARNING if is_new else logging.INFO  # where logs are not set up, the first
        logger.log(level, "compiling the flow step: a minute when new, longer on a busy machine")
        if self.num_workers:
            self.workers = self._start_workers()
        else:
            self._compile_here(is_new)
        self._is_ready = True
        logger.info("flow step ready after %.1f s", time.perf_counter() - began)

    def _start_workers(self) -> Workers:
        """Start the workers, which share out the parts of the step to compile; make the check."""
        assert self._shared is not None
        workers = Workers(
            self._configs,
            group_size=self.group_size,
            file=self._shared.fileno(),
            count=self.num_workers,
            compile=self._wants_compile,
        )
        try:
            if self._wants_compile:
                with one_thread():  # as ``is_new`` has looked for it
                    self.batch.compile_check()
            workers.wait()
        except BaseException:  # as by Ctrl-C: the next time begins from the start
            workers.close()
            raise
        self._shared.close()
        return workers

    def _compile_here(self, is_new: bool) -> None:
        """Compile all parts, those of a single flow in two processes if they are new."""
        is_shared = is_new and self._is_alone and count_cores() > 1
        aside = compiling_aside(self._configs) if is_shared else nullcontext()
        with self._limit_threads(), aside:
            self.batch.compile(with_check=True)

    def _limit_threads(self) -> AbstractContextManager[None]:
        """Return a context in which flows that need one worker run here as they would there."""
        return one_thread() if self._is_alone else nullcontext()

    def advance_(self, num_steps: int, groups: Collection[int]) -> None:
        """Advance some groups by an even number of steps, and wait; RuntimeError once closed."""
        if self._end:
            raise RuntimeError(f"this solver {self._end}: make a new one")
        self.compile()
        self.batch.before_()
        if self.num_workers:
            assert self.workers is not None
            self.workers.advance_(num_steps, groups)
        else:
            try:
                with self._limit_threads():
                    self.batch.advance_(num_steps, groups)
            except BaseException:  # as by Ctrl-C: in the middle of a step
                self._end = "was interrupted within a step"
                raise
        self.batch.after_(groups)

    def close(self) -> None:
        """End the workers, if any; the flows can still be read."""
        self._end = "is closed"
        if self.workers is not None:
            self.workers.close()
