"""Teach a fish with other senses what a trained policy does, and see how far its senses carry it.

    python examples/imitate.py own_motion lateral_line
    python examples/imitate.py own_motion flow_label --streams 0.4 0.45 0.5
    python examples/imitate.py own_motion lateral_line --teacher runs/<name>

DAgger (Ross, Gordon & Bagnell 2011, AISTATS, algorithm 3.1): the student acts, the teacher, whose
senses it lacks, says what it would have done there, and the student learns that from all that was
seen so far. In the first round the teacher acts, in the second each of them half of the time. The
student is an ordinary policy; its checkpoint serves ``fishrl evaluate`` and ``fishrl view``.
"""

import argparse
import itertools
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import get_args

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from fishrl.envs import Flows, KarmanGait, Oracle, make_env
from fishrl.envs.episodes import run_episodes
from fishrl.envs.senses import SenseName
from fishrl.modules.actors import ILLEGAL_LOGIT
from fishrl.pages import write_csv
from fishrl.programs.statistics import find_share
from fishrl.training import evaluate, load_plan, load_policy
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.evaluation import TRAIN_SEED
from fishrl.training.plan import Plan
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import write_json


@dataclass(frozen=True, kw_only=True)
class Budget:
    """What a student may spend, and how it learns.

    Args:
        decisions: of all rounds; the round that exceeds it is the last.
        episodes: of a round.
        num_stacked: observations that the student sees at once.
        epochs: passes over all that was seen, after each round.
        batch_size: decisions in a gradient step.
        learning_rate: Adam's.
        seed: of starts, actions and weights.
    """

    decisions: int = 20_000
    episodes: int = 32
    num_stacked: int = 16
    epochs: int = 12
    batch_size: int = 128
    learning_rate: float = 1e-3
    seed: int = 0


class Standardised(nn.Module):
    """A network whose inputs ``[..., n]`` have mean 0 and deviation 1, as of the latest fit."""

    def __init__(self, network: nn.Sequential, num_inputs: int) -> None:
        super().__init__()
        self.network = network
        self.mean, self.deviation = torch.zeros(num_inputs), torch.ones(num_inputs)

    def forward(self, inputs: Tensor) -> Tensor:
        """Return the logits ``[..., num_actions]``."""
        logits: Tensor = self.network((inputs - self.mean) / self.deviation)
        return logits

    def fold(self) -> None:
        """Let the first layer do the scaling, so that the network takes the inputs as they are."""
        first = self.network[0]
        assert isinstance(first, nn.Linear)
        with torch.no_grad():
            first.weight /= self.deviation
            first.bias -= first.weight @ self.mean


class Lesson:
    """A teacher, and a student with senses of its own, in flows where both can be observed.

    Args:
        name: the teacher, as in ``load_policy``: discrete actions for the Kármán gait.
        senses: what the student observes.
        budget: of the student.
        streams: their speeds in L/T, drawn per episode; by default the teacher's. A student with
            ``flow_label`` knows which.

    Raises:
        ValueError: for another teacher.
    """

    def __init__(
        self,
        name: str,
        senses: tuple[SenseName, ...],
        budget: Budget,
        streams: tuple[float, ...] = (),
    ) -> None:
        self.budget = budget
        teacher, task = load_policy(name), load_plan(name).task
        has_logits = "logits" in teacher.out_keys
        if not isinstance(task, KarmanGait) or task.num_label_inputs or not has_logits:
            raise ValueError(
                f"teacher = {name}: give one of discrete SAC or PPO for the Kármán gait, with "
                "discrete actions and no flow label, such as zoo/gait_bend"
            )
        if streams:
            stream = replace(task.stream, speeds_bl=streams)
            task = replace(task, stream=stream, start_flows=tuple(range(len(streams))))
        self.teacher, self._of_teacher = teacher.module[0].module, (task.num_stacked, task.n_obs)
        self.recognition = Oracle() if "flow_label" in senses else None
        self.task = replace(task, observes=senses, num_stacked=budget.num_stacked)
        self.both = replace(
            task,
            observes=(*task.observes, *senses),
            num_stacked=max(task.num_stacked, budget.num_stacked),
        )
        self.plan = Plan(
            task=self.task,
            recognition=self.recognition,
            seed=budget.seed,
            total_frames=budget.decisions,
        )
        has_labels = self.recognition is not None
        self.spec = PolicySpec.for_task(self.task, has_labels=has_labels)
        self.generator = torch.Generator().manual_seed(budget.seed)
        self.policy = self.plan.algorithm.make_policy(self.spec, self.generator)
        self.student = Standardised(self.policy.module[0].module, self.spec.num_inputs)
        self.seen: list[tuple[Tensor, Tensor, Tensor]] = []  #: inputs, teacher's logits, masks

    def act(self, state: TensorDictBase, share: float) -> TensorDictBase:
        """Let the teacher act in a ``share`` of the rows, drawn anew, and the student elsewhere."""
        stack = state["observation_stack"].unflatten(-1, (self.both.num_stacked, -1))
        last, size = self._of_teacher
        state["inputs"] = stack[:, -self.budget.num_stacked :, size:].flatten(1)
        state["wanted"] = self.teacher(stack[:, -last:, :size].flatten(1))
        is_taught = torch.rand(len(stack), 1, generator=self.generator) < share
        logits = torch.where(is_taught, state["wanted"], self.student(state["inputs"]))
        chance = logits.masked_fill(~state["action_mask"], ILLEGAL_LOGIT).softmax(-1)
        state["action"] = chance.multinomial(1, generator=self.generator).squeeze(-1)
        return state

    def keep(self, start_of: Tensor, step: TensorDictBase) -> None:
        """Keep what was seen in the rows that ran."""
        rows = step[start_of >= 0]
        self.seen.append((rows["inputs"], rows["wanted"], rows["action_mask"]))

    def fit(self, epochs: int) -> float:
        """Fit the student to all that was seen, and return the loss of the last epoch."""
        inputs, wanted, mask = (torch.cat(part) for part in zip(*self.seen, strict=True))
        self.student.mean, self.student.deviation = inputs.mean(0), inputs.std(0) + 1e-3
        chance = wanted.masked_fill(~mask, ILLEGAL_LOGIT).softmax(-1)
        optimiser = torch.optim.Adam(self.student.parameters(), lr=self.budget.learning_rate)
        for _ in range(epochs):
            total = 0.0
            order = torch.randperm(len(inputs), generator=self.generator)
            for batch in order.split(self.budget.batch_size):
                logits = self.student(inputs[batch]).masked_fill(~mask[batch], ILLEGAL_LOGIT)
                loss = nn.functional.cross_entropy(logits, chance[batch])
                optimiser.zero_grad()
                loss.backward()
                optimiser.step()
                total += len(batch) * float(loss.detach())
        return total / len(inputs)

    def give(self, *, flows: Flows = Flows()) -> list[tuple[int, float, float]]:
        """Give the lesson, and print and return its rounds.

        Of each the decisions so far, the mean duration of its episodes in T and the loss.
        """
        budget, spent, rounds = self.budget, 0, []
        starts_of = torch.Generator().manual_seed(TRAIN_SEED + budget.seed)
        env = make_env(task=self.both, flows=flows, seed=0, recognition=self.recognition)
        for share in itertools.chain((1.0, 0.5), itertools.repeat(0.0)):
            starts = self.both.sample_starts(budget.episodes, starts_of)
            episodes = run_episodes(env, partial(self.act, share=share), starts, on_step=self.keep)
            spent += int(episodes.lengths.sum())
            is_last = spent >= budget.decisions
            loss = self.fit(budget.epochs * (4 if is_last else 1))
            rounds.append((spent, lasted := episodes.metrics()["mean_length_T"], loss))
            print(f"{spent} decisions, by the teacher {share:.0%}: {lasted:.1f} T, loss {loss:.2f}")
            if is_last:
                break
        env.close()
        self.student.fold()
        return rounds


def main() -> None:
    """Give a lesson, save the student, and try it from 24 starts for 40 T."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("senses", nargs="+", choices=get_args(SenseName), metavar="sense")
    parser.add_argument("--teacher", default="zoo/gait_bend", help="or a run folder")
    parser.add_argument("--streams", nargs="*", type=float, default=[], metavar="L/T")
    parser.add_argument("--decisions", type=int, default=Budget.decisions)
    parser.add_argument("--stacked", type=int, default=Budget.num_stacked)
    parser.add_argument("--seed", type=int, default=Budget.seed)
    parser.add_argument("--folder", type=Path, default=Path("runs/imitation"))
    chosen = parser.parse_args()
    if chosen.folder.exists():
        parser.error(f"--folder {chosen.folder}: is there already; name a new one")
    budget = Budget(decisions=chosen.decisions, num_stacked=chosen.stacked, seed=chosen.seed)
    lesson = Lesson(chosen.teacher, tuple(chosen.senses), budget, tuple(chosen.streams))
    rounds, folder, config = lesson.give(), chosen.folder, lesson.plan.to_config()
    actor = {"actor": lesson.policy}
    save_checkpoint(folder, actor, spec=lesson.spec, frames=rounds[-1][0], config=config)
    write_csv(folder / "metrics.csv", ("frames", "mean_length_T", "loss"), rounds)
    longer = replace(lesson.task, time_limit=321)
    result = evaluate(folder, task=longer, episodes=24, flows=Flows(num_envs=12))
    write_json(folder / "summary.json", result | {"teacher": chosen.teacher})
    share = find_share(round(24 * result["success_rate"]), 24).show(".0%")
    print(f"{folder} lasts 40 T: {share}, {result['mean_length_T']:.1f} T on average")


if __name__ == "__main__":
    main()
