"""Settings of a training: for learning, and for running and reporting."""

from typing import Annotated

from pydantic import (
    AfterValidator,
    Field,
    NonNegativeFloat,
    NonNegativeInt,
    PositiveFloat,
    PositiveInt,
)

from fishrl.envs import Flows
from fishrl.settings import Role, Settings


class LearningSettings(Settings):
    """Settings that determine the result of a training; fixed once a run has begun.

    Args:
        seed: seed of networks, starts and actions; it determines the learning curve.
        flows: number of flows, and how they are computed; only ``flows.num_envs`` is fixed.
        ray_collectors: number of processes of a Ray cluster that share the flows, each on its own
            GPU with ``flows.device=cuda``; with 0 all flows belong to this process.
        warmup_frames: env frames with random legal actions before learning starts. PPO sets this,
            ``updates_per_frame`` and ``buffer_size`` itself.
        updates_per_frame: gradient steps per env frame and fish.
        batch_size: transitions per gradient step.
        buffer_size: capacity of the replay buffer in decisions of flows, each with a transition per
            fish.
        gamma: discount per decision.
        learning_rate: Adam learning rate of all networks.
        tau: rate of the soft update of target networks at each gradient step.
        hidden: widths of the hidden layers of every network.
        actor_average: env frames over which the weights of the policy are averaged. The average is
            evaluated, selected and saved; the newest weights explore. 0: no average.
        scale_inputs: whether networks read each number observed as its deviation from the mean, in
            standard deviations, both measured in the warm-up; of PPO in the first rollout. Saved
            policies read observations: the scale is folded into their first layer.
        initial_policy: trained policy whose weights the new one begins with, of the same algorithm,
            observations and actions: run folder, checkpoint or ``zoo/<name>``.
        critic_frames: env frames after the warm-up in which policy and temperature rest, and the
            critics alone learn.
        reflect: whether half of the replayed transitions, drawn at random, are reflected about the
            axis of the flow; for tasks that have a mirror image.
    """

    seed: Annotated[NonNegativeInt, Field(lt=2**32)] = 0
    flows: Flows = Flows()
    ray_collectors: Annotated[NonNegativeInt, Field(le=10_000)] = 0
    warmup_frames: NonNegativeInt = 320
    updates_per_frame: Annotated[NonNegativeFloat, Field(le=1e6)] = 4.0
    batch_size: PositiveInt = 64
    buffer_size: PositiveInt = 20_000
    gamma: Annotated[NonNegativeFloat, Field(le=1)] = 0.99
    learning_rate: Annotated[PositiveFloat, Field(le=1)] = 5e-4
    tau: Annotated[NonNegativeFloat, Field(le=1)] = 0.01
    hidden: tuple[PositiveInt, ...] = (256, 256)
    actor_average: NonNegativeInt = 0
    scale_inputs: bool = False
    initial_policy: Annotated[str, Field(min_length=1)] | None = None
    critic_frames: NonNegativeInt = 0
    reflect: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.batch_size > self.buffer_size:
            raise ValueError(
                f"batch_size = {self.batch_size}: must be at most buffer_size = {self.buffer_size}"
            )
        if self.ray_collectors and self.flows.num_envs % self.ray_collectors:
            raise ValueError(
                f"flows.num_envs = {self.flows.num_envs}: must be a multiple of ray_collectors = "
                f"{self.ray_collectors}"
            )


def _check_name(name: str | None) -> str | None:
    if name is not None and (not name or name in (".", "..") or set(name) & {*"/\\"}):
        raise ValueError("a name without slashes, of a folder in ``folder``")
    return name


class RunSettings(Settings):
    """Where a training runs and how often it reports; may change when a run is resumed.

    Args:
        total_frames: env frames to train for; one decision in one flow is a frame.
        learner_device: device of networks and replay buffer; by default the flows' device.
        folder: folder of all run folders.
        name: name of the run folder; by default made from task, preset, algorithm and seed.
        log_frames: frames between rows of the metrics.
        checkpoint_frames: frames between checkpoints.
        keep_checkpoints: how many of the newest checkpoints are kept.
        eval_frames: frames between evaluations of the greedy policy.
        eval_episodes: number of fixed starts of these evaluations, which select the best
            checkpoint.
        final_episodes: number of fixed starts of the final evaluation, different from those.
        baselines: policies evaluated from the same final starts; by default the task's, see
            ``fishrl.training.baselines``.
    """

    total_frames: Annotated[PositiveInt, Role.CONTINUATION] = 2800
    learner_device: Annotated[str | None, Role.CONTINUATION] = None
    folder: Annotated[str, Field(min_length=1), Role.HARMLESS] = "runs"
    name: Annotated[str | None, AfterValidator(_check_name), Role.HARMLESS] = None
    log_frames: Annotated[PositiveInt, Role.HARMLESS] = 64
    checkpoint_frames: Annotated[PositiveInt, Role.HARMLESS] = 350
    keep_checkpoints: Annotated[PositiveInt, Role.HARMLESS] = 2
    eval_frames: Annotated[PositiveInt, Role.CONTINUATION] = 700
    eval_episodes: Annotated[PositiveInt, Field(le=10**6), Role.CONTINUATION] = 16
    final_episodes: Annotated[PositiveInt, Field(le=10**6), Role.EVALUATION] = 32
    baselines: Annotated[tuple[str, ...] | None, Role.EVALUATION] = None
