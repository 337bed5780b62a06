"""Export a learned policy as a heading controller: ``python -m experiments.export_steering``.

Writes the actor's weights of a run of ``task=predation`` as ``PolicySteering`` reads them. The
file that comes with the package was made by ``make train`` and ``python -m
experiments.export_steering run=runs/predation-seed0 path=fishrl/envs/steering.pt``.
"""

from pathlib import Path

from torch import nn

from fishrl.envs import Predation
from fishrl.envs.steering import PolicySteering, save_weights
from fishrl.files import staged
from fishrl.programs.program import program
from fishrl.settings import Settings
from fishrl.training.policies import load_plan, load_policy


class ExportSettings(Settings):
    """Settings of an export.

    Args:
        run: folder of a run of ``task=predation``, or a checkpoint.
        path: file to write.
    """

    run: str
    path: str


@program(ExportSettings)
def main(settings: ExportSettings) -> None:
    """Write the weights of a run's best actor, or nothing if it cannot steer."""
    checkpoint, plan = load_plan(settings.run)
    if not isinstance(plan.task, Predation):
        raise ValueError(f"run = {settings.run}: must be a policy trained on Predation")
    layers = [m for m in load_policy(checkpoint).modules() if isinstance(m, nn.Linear)]
    with staged(Path(settings.path)) as stage:
        save_weights([(layer.weight, layer.bias) for layer in layers], stage)
        PolicySteering(path=str(stage), turn_degrees=plan.task.turn_degrees)
    print(f"written to {settings.path}")


if __name__ == "__main__":
    main()
