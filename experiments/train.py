"""Teach a fish: ``python -m experiments.train task=predation preset=small seed=0``.

``resume=<run folder>`` goes on where a run was stopped or killed; one that is finished stays as it
is, unless ``total_frames`` makes it longer.
"""

from __future__ import annotations

import logging
import sys
import time
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING, Any

from fishrl.training.progress import Progress

if TYPE_CHECKING:
    from pathlib import Path

    from omegaconf import DictConfig

    from experiments.settings import TrainConfig
    from fishrl.training.loop import Training
    from fishrl.training.run_folder import RunFolder

logger = logging.getLogger(__name__)

#: Settings that a resume sets for itself alone: whether to look on, and where things lie.
_OF_THE_MOMENT = ("live", "recognition", "resume")
#: Settings with which a finished run is evaluated or drawn anew.
_OF_THE_END = ("final_episodes", "baselines", "picture_episodes")


def train(
    config: TrainConfig,
    *,
    make_env: Any = None,
    progress: Progress | None = None,
    began: float | None = None,
) -> dict[str, Any]:
    """Train a fish, compare it with the hand-written ones, and draw what it does.

    Args:
        config: the settings.
        make_env: makes the env of a task; by default ``fishrl.envs.flow_env.make_env``.
        progress: the bar, if there is one already.
        began: ``time.perf_counter()`` when the program started.

    Returns:
        The summary, as in ``summary.json``.

    Raises:
        ValueError: for settings that cannot be, and checkpoints that do not fit.
    """
    training = set_up(config, make_env=make_env, progress=progress, began=began)
    return finish(training)


def set_up(
    config: TrainConfig,
    *,
    make_env: Any = None,
    progress: Progress | None = None,
    began: float | None = None,
) -> Training:
    """Make everything a run needs; see ``train``. Wrong settings show here, not later."""
    from pathlib import Path

    from experiments.config import build
    from experiments.settings import check_cluster, check_device
    from fishrl.training.algorithms import build_algorithm
    from fishrl.training.baselines import make_baselines
    from fishrl.training.loop import FINAL_SEED, Training, make_flow_env
    from fishrl.training.recognition import Recognition, find_machine
    from fishrl.training.run_folder import RunFolder

    with ExitStack() as stack:
        if config.resume:
            folder = RunFolder.of_existing(config.resume)
            stack.enter_context(folder.noting_failure())
        check_device(config.device)
        check_cluster(config.ray_collectors)
        if config.live:
            config.choose_flows(config.num_envs, default=1)
        metrics_logger = build(config.logger)
        choice = find_machine(config.recognition, Path(config.resume or "."))
        recognition = Recognition(build(config.task), choice)
        task = recognition.task
        baselines = make_baselines(config.baselines, task=task, seed=FINAL_SEED)
        if not config.resume:
            kind = type(task).__name__.lower()
            label = build_algorithm({"algorithm": config.algorithm}).label
            words = [kind, config.preset, label, f"seed{config.seed}"]
            name = config.name or "-".join(filter(None, words))
            folder = begin_run(config, RunFolder.create(parent=config.folder, name=name))
            stack.enter_context(folder.noting_failure())
        logger.info("run folder: %s", folder.path)
        training = Training(
            config=config,
            recognition=recognition,
            make_env=make_env or make_flow_env(),
            baselines=baselines,
            folder=folder,
            metrics_logger=metrics_logger,
            progress=progress or Progress(is_shown=False),
            began=time.perf_counter() if began is None else began,
        )
        if config.resume:
            if folder.has_begun():
                training.resume()
                folder.summary.unlink(missing_ok=True)  # it will be another one
            note_settings(config, folder)
        return training


def begin_run(config: TrainConfig, folder: RunFolder) -> RunFolder:
    """Write into a new folder all that its run needs; ``resume=<folder>`` then starts it."""
    from experiments.config import to_plain
    from fishrl.training.recognition import keep_machine
    from fishrl.training.run_folder import write_yaml

    config.recognition = keep_machine(config.recognition, folder.path)
    write_yaml(folder.config, to_plain(config))
    return folder


def note_settings(config: TrainConfig, folder: RunFolder) -> None:
    """Write what a resumed run was given anew, for the next resume.

    What is of the moment stays as the run was begun with.
    """
    from omegaconf import OmegaConf

    from experiments.config import to_plain
    from fishrl.training.run_folder import write_yaml

    stored: Any = OmegaConf.to_container(OmegaConf.load(folder.config))
    begun_with = {name: stored[name] for name in _OF_THE_MOMENT if name in stored}
    settings = to_plain(config) | begun_with
    if settings != stored:
        write_yaml(folder.config, settings)


def is_over(config: TrainConfig) -> bool:
    """Tell whether a resumed run is finished, and nothing more is asked of it."""
    from pathlib import Path

    from experiments.config import to_plain
    from experiments.sweeps.runs import read_run

    run, asked = read_run(Path(str(config.resume)).expanduser()), to_plain(config)
    if run.status != "finished" or config.total_frames > run.summary.get("frames", 0):
        return False
    return all(asked[name] == run.config.get(name, asked[name]) for name in _OF_THE_END)


def finish(training: Training) -> dict[str, Any]:
    """Run what is set up to its end, write the summary and the pictures, and print the table."""
    from fishrl.training.interruption import Interrupted
    from fishrl.training.run_folder import write_json

    config, folder = training.config, training.folder
    with folder.noting_failure(), closing(training):
        summary = training.run()
        try:
            if config.picture_episodes > 0:
                draw(training, summary)
                summary["wall_seconds"] = training.wall_seconds()
        except Interrupted:  # not finished, so that a resume draws them
            raise
        except Exception:
            write_json(folder.summary, summary)
            raise
        write_json(folder.summary, summary)
    training.progress.close()
    report(summary, folder=folder.path)
    return summary


def draw(training: Training, summary: dict[str, Any]) -> None:
    """Record the learned policy from some of the fixed starts and draw the pictures of the run."""
    from experiments.figures.run_pictures import record_run
    from fishrl.training.evaluation import fixed_starts
    from fishrl.training.loop import FINAL_SEED

    config, progress = training.config, training.progress
    starts = fixed_starts(training.task, config.final_episodes, seed=FINAL_SEED)
    starts = starts[: config.picture_episodes]
    progress.start("pictures", total=starts.shape[0])
    record_run(
        training.folder.path,
        training.collector.env,
        training.watch(training.learner.actor),  # stops where the program is told to end
        starts,
        settings=config,
        baselines={name: summary[f"{name}_success_rate"] for name in summary["baselines"]},
        on_episodes=progress.advance,
    )


def report(summary: dict[str, Any], *, folder: Path) -> None:
    """Print the table of all fish, where the files lie, and how to look at it."""
    from experiments.command_line import show_command

    word = summary["success"]
    print(f"\n{'fish':<12}{word:>14}{'mean return':>14}{'mean duration':>16}{f'until {word}':>18}")
    for name in ("learned", *summary["baselines"]):
        prefix = "" if name == "learned" else f"{name}_"
        duration = summary[f"{prefix}mean_time_to_success_T"]
        shown = "-" if duration != duration else f"{duration:.1f} T"
        print(
            f"{name:<12}{summary[f'{prefix}success_rate']:>13.0%} "
            f"{summary[f'{prefix}mean_return']:>13.1f}"
            f"{summary[f'{prefix}mean_length_T']:>14.1f} T{shown:>18}"
        )
    print(f"({summary['episodes']} fixed starts, {summary['wall_seconds'] / 60:.1f} minutes)\n")
    for path in sorted(folder.iterdir()):
        if not path.name.startswith("."):
            print(f"  {path}")
    shown = str(folder) if (folder / "capture.rrd").is_file() else f"run={folder}"
    print(f"\nlook again: {show_command('experiments.evaluate', f'checkpoint={folder}')}")
    print(f"see it swim: {show_command('experiments.view', shown)}")


def main() -> None:
    """Read the command line; show the bar before the slow imports."""
    began = time.perf_counter()
    with Progress() as progress:
        import hydra

        from experiments.command_line import (
            plain_errors,
            read_arguments,
            resumable,
            set_up_logging,
            training_settings,
        )
        from experiments.config import CONF
        from experiments.sweeps.jobs import is_sweep, run_job, sweep

        set_up_logging()
        sys.argv[1:] = read_arguments("train", sys.argv[1:])

        def run(config: DictConfig) -> None:
            with plain_errors():
                settings = training_settings(config)
                if settings.resume and is_over(settings):
                    progress.close()
                    print(f"{settings.resume}: already finished; total_frames=... makes it longer")
                    return
                training = set_up(settings, progress=progress, began=began)
                with resumable(training):
                    finish(training)

        decorate = hydra.main(config_path=str(CONF), config_name="train", version_base="1.3")
        if not is_sweep(sys.argv[1:]):
            decorate(run)()
            return
    sweep(decorate(run_job))


if __name__ == "__main__":
    main()
