"""Time a decision of 16 flows outside the flow, and what is left of it without a decision.

    python studies/performance_history/outside.py
"""

from statistics import median
from time import perf_counter
from typing import Any

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torchrl.envs import ExplorationType, set_exploration_type

from fishrl.envs import Flows, make_env, make_task
from fishrl.modules import make_actor


class Count(TorchDispatchMode):
    """Counts operators."""

    num = 0

    def __torch_dispatch__(self, op: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.num += 1
        return op(*args, **kwargs or {})


def main() -> None:
    torch.set_num_threads(1)
    task = make_task("gait_bend")
    env = make_env(task=task, flows=Flows(num_envs=16), seed=0)
    sizes = {"num_inputs": task.num_stacked * task.n_obs, "num_actions": task.num_actions}
    policy, base, spent = make_actor(**sizes), env.base_env, [0.0]
    advance, state, last = base.solver.advance_, env.reset(), list[Any]()

    def flow(*arguments: Any) -> None:
        start = perf_counter()
        advance(*arguments)
        spent[0] += perf_counter() - start

    @torch.no_grad()
    def act(num: int) -> tuple[float, float]:
        """Return milliseconds of a decision, and of those in the flow."""
        nonlocal state
        times = []
        for _ in range(num):
            spent[0], start = 0.0, perf_counter()
            with set_exploration_type(ExplorationType.RANDOM):
                _, state = env.step_and_maybe_reset(policy(state))
            times.append((perf_counter() - start, spent[0]))
        whole, own = zip(*times, strict=True)
        return 1e3 * median(whole), 1e3 * median(own)

    base.solver.advance_ = flow
    act(20)
    print("decision and its flow, ms: {:.1f}, {:.1f}".format(*act(60)))
    with Count() as count:
        act(1)
    decide = base._decide
    base._decide = lambda given: last.append(decide(given)) or last[-1]
    act(1)
    after, problems = last[-1]
    base._decide = lambda given: ({key: value.clone() for key, value in after.items()}, problems)
    print(f"operators {count.num}; with a decision at hand, ms: {act(200)[0]:.1f}")
    env.close()


if __name__ == "__main__":
    main()
