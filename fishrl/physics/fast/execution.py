"""Where a batch of flows lies and advances: in this process, or in one process per core."""

import logging
import time
from collections.abc import Collection, Sequence
from typing import IO

import torch
from torch import Tensor

from fishrl.limits import count_cores, count_running
from fishrl.physics.fast.batch import FlowBatch
from fishrl.physics.fast.compiled import find_compiler_problem
from fishrl.physics.fast.workers import Workers, can_send, map_shared, open_shared
from fishrl.physics.flow import FlowConfig

logger = logging.getLogger(__name__)


class Execution:
    """A batch of flows and the processes that advance it; arguments as of ``InPlaceSolver``.

    Attributes:
        batch: the flows; with workers, in memory shared with them.
        group_size: flows per group.
        num_workers: additional processes.
        workers: those processes, once they have started.
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
        can_share = is_cpu and can_send(configs)
        if num_workers is None:
            is_compiled = can_share and compile and not find_compiler_problem("cpu")
            num_workers = min(count_cores(), num_envs) if is_compiled else 0
        if num_workers < 0 or (num_workers and not can_share):
            raise ValueError(
                f"num_workers = {num_workers} on {device}: must be 0 on a GPU; on a CPU, workers "
                "need Linux or macOS, and each class of the configuration in a module, not in a "
                "script or function"
            )
        self.group_size = flows_per_launch or (1 if is_cpu else num_envs)
        if self.group_size < 1 or num_envs % self.group_size:
            raise ValueError(
                f"flows_per_launch = {flows_per_launch}: must divide the number of flows {num_envs}"
            )
        self.num_workers = min(num_workers, num_envs // self.group_size)
        self.workers: Workers | None = None
        self._configs, self._device, self._wants_compile = configs, device, compile
        self._shared: IO[bytes] | None = None
        self._is_closed = self._is_ready = False
        self.batch = FlowBatch(
            configs,
            group_size=self.group_size,
            device=device,
            allocate=self._allocate,
            compile=compile,
        )

    def _allocate(self, num_bytes: int) -> Tensor:
        if not self.num_workers:
            return torch.zeros(num_bytes, dtype=torch.uint8, device=self._device)
        self._shared = open_shared(num_bytes)
        return map_shared(self._shared.fileno(), num_bytes)

    def compile(self) -> None:
        """Compile the step and start the workers, once."""
        if self._is_ready or not (self.num_workers or self._wants_compile):
            return
        stepper, first, began = self.batch.stepper, self.batch.first, time.perf_counter()
        logger.info("compiling the flow step (up to a minute when new) ...")
        if self._shared is None:
            stepper.compile(first)
        elif self.workers is None:
            self.workers = Workers(
                self._configs,
                group_size=self.group_size,
                file=self._shared.fileno(),
                count=self.num_workers,
                compile=self._wants_compile,
                has_helper=self._can_help(),
            )
            self._shared.close()
        if self.workers is not None:
            self.workers.wait()
            self.workers.end_helper()
        if self._wants_compile:  # only now: killed meanwhile, this process would leave its compiler
            stepper.compile_check(first)
        self._is_ready = True
        logger.info("flow step ready after %.1f s", time.perf_counter() - began)

    def _can_help(self) -> bool:
        """Return whether there is something to compile, and an idle core."""
        num_busy = self.num_workers + count_running() - 1  # this process will wait
        if not self._wants_compile or num_busy >= count_cores():
            return False
        num_threads = torch.get_num_threads()
        torch.set_num_threads(1)  # on which code depends: as in the workers
        try:
            return self.batch.stepper.is_new(self.batch.first)
        finally:
            torch.set_num_threads(num_threads)

    def advance_(self, num_steps: int, groups: Collection[int]) -> None:
        """Advance some groups by an even number of steps, and wait; RuntimeError once closed."""
        if self._is_closed:
            raise RuntimeError("this solver is closed and cannot advance: make a new one")
        self.compile()
        if self.workers is not None:
            self.workers.advance_(num_steps, groups)
        else:
            self.batch.advance_(num_steps, groups)

    def close(self) -> None:
        """End the workers, if any; the flows can still be read."""
        self._is_closed = True
        if self.workers is not None:
            self.workers.close()
