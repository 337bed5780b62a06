"""Teach a lateral line to name its flow: ``python -m experiments.train_lateral_line seed=0``.

Collects labelled signals of fish that hold stations and act at random, half of the decisions each,
fits a machine, and writes what it can tell: ``lateral_line.md`` with figures,
``lateral_line.json``, and ``machine.pt``, which the task takes.
``preset=gait_small`` makes it for the fish of that preset.
Collected data are kept: the same command goes on after an interruption, and other fits use them.
"""

from __future__ import annotations

import logging
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fishrl.training.progress import Progress

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from experiments.settings import LateralLineConfig

logger = logging.getLogger(__name__)


def train_lateral_line(
    config: LateralLineConfig, *, progress: Progress | None = None
) -> dict[str, Any]:
    """Collect data, fit a machine, put the questions of the study, and write the run folder.

    Args:
        config: the settings.
        progress: the bar, if there is one already.

    Returns:
        The findings, as in ``lateral_line.json``, and ``folder``.

    Raises:
        ValueError: for settings that cannot be.
    """
    from experiments.config import build, to_plain
    from experiments.lateral_line.collection import Collection, collect
    from experiments.lateral_line.examination import examine
    from experiments.settings import check_device
    from fishrl.training.run_folder import RunFolder, write_yaml

    progress = progress or Progress(is_shown=False)
    check_device(config.device)
    task = build(config.task)
    collection = Collection(
        task=task,
        num_envs=config.num_envs,
        max_decisions=config.max_decisions,
        seed=config.seed,
    )
    name = config.name or f"lateral-line-{type(task).__name__.lower()}-seed{config.seed}"
    folder = RunFolder.create(parent=config.folder, name=name)
    write_yaml(folder.config, to_plain(config))
    logger.info("run folder: %s", folder.path)
    episodes = collect(
        collection,
        num_samples=config.num_samples,
        folder=Path(config.data_folder),
        device=config.device,
        compile=config.compile,
        progress=progress,
    )
    return examine(config, task=task, episodes=episodes, folder=folder.path, progress=progress)


def main() -> None:
    """Read the command line; show the bar before the slow imports."""
    with Progress() as progress:
        import hydra

        from experiments.command_line import plain_errors, read_arguments, set_up_logging
        from experiments.config import CONF, to_settings

        set_up_logging()
        sys.argv[1:] = read_arguments("train_lateral_line", sys.argv[1:])

        @hydra.main(config_path=str(CONF), config_name="train_lateral_line", version_base="1.3")
        def run(config: DictConfig) -> None:
            with plain_errors():
                settings = to_settings("train_lateral_line", config)
                findings = train_lateral_line(settings, progress=progress)
            progress.close()
            print((findings["folder"] / "lateral_line.md").read_text(encoding="utf-8"))
            print(f"written to {findings['folder']}")

        run()


if __name__ == "__main__":
    main()
