"""Make a helmsman of a fish that learned to catch food: ``python -m experiments.export_steering``.

Writes the actor's weights of a run of ``task=predation`` as ``PolicySteering`` reads them. The one
that comes with the package was made by ``make train`` and
``python -m experiments.export_steering runs/predation-small-seed0 fishrl/envs/steering.pt``.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from torch import Tensor, nn

from experiments.command_line import plain_errors
from experiments.config import build
from fishrl.envs.steering import PolicySteering, save_weights
from fishrl.training.baselines import load_policy
from fishrl.training.checkpoint import read_metadata


def export_steering(run: Path, path: Path) -> PolicySteering:
    """Write the weights of a run's best actor, and read them back.

    Args:
        run: folder of a run of ``task=predation``, or a checkpoint.
        path: of the file.

    Raises:
        ValueError: if there is no such run, or its fish cannot steer.
    """
    _, metadata = read_metadata(str(run))
    task = build(metadata["config"]["task"])
    actor = load_policy(str(run), task=task, device="cpu")
    layers: list[tuple[Tensor, Tensor]] = [
        (module.weight, module.bias) for module in actor.modules() if isinstance(module, nn.Linear)
    ]
    save_weights(layers, path)
    try:
        return PolicySteering(path=str(path), turn_degrees=getattr(task, "turn_degrees", 15.0))
    except ValueError:
        path.unlink()
        raise


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Weights of a learned fish, to steer with.")
    parser.add_argument("run", type=Path, help="run folder of task=predation")
    parser.add_argument("path", type=Path, help="file to write")
    arguments = parser.parse_args()
    with plain_errors():
        export_steering(arguments.run, arguments.path)
    print(f"written to {arguments.path}")


if __name__ == "__main__":
    main()
