"""Train a policy: ``fishrl train task=predation preset=quick seed=0``.

``name=<folder>`` starts a run in that folder, or continues the one there;
``resume=<run folder>`` continues a run with its own settings. A finished run is left unchanged
unless ``total_frames`` extends it, or another final evaluation or other pictures are asked for.
"""

import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from torchrl.envs import EnvBase

from fishrl.envs.episodes import Policy
from fishrl.programs.configuration import quote
from fishrl.programs.figures.run_pictures import record_run
from fishrl.programs.live import LiveView
from fishrl.programs.program import program, show_command
from fishrl.programs.statistics import find_share
from fishrl.programs.sweeps.jobs import sweep
from fishrl.programs.sweeps.runs import show_modules, show_resume
from fishrl.programs.train_settings import TRAINING, TrainConfig
from fishrl.training.callback import Callback
from fishrl.training.checkpoint import Checkpoint
from fishrl.training.evaluation import FINAL_SEED, fixed_starts
from fishrl.training.interruption import Interrupted, exit_status
from fishrl.training.loop import Training
from fishrl.training.opening import open_run
from fishrl.training.progress import Progress
from fishrl.training.runs import complete


class RunCallback(LiveView):
    """The live view of a run, and at the end its results and pictures."""

    def __init__(self, config: TrainConfig, progress: Callback) -> None:
        super().__init__(config, num_flows=config.flows.num_envs)
        self.config, self.progress = config, progress

    def on_end(
        self, summary: Mapping[str, Any], *, folder: Path, env: EnvBase, policy: Policy
    ) -> None:
        """Print the results, record the policy from some of their starts and draw the pictures."""
        show_results(summary)
        if self.config.picture_episodes == 0:
            return
        starts = fixed_starts(env.base_env.task, self.config.final_episodes, seed=FINAL_SEED)
        starts = starts[: self.config.picture_episodes]
        self.progress.on_phase("pictures", total=starts.shape[0])
        record_run(
            folder,
            env,
            policy,
            starts,
            settings=self.config,
            baselines={name: summary[f"{name}_success_rate"] for name in summary["baselines"]},
            on_episodes=self.progress.on_progress,
        )


def show_results(summary: Mapping[str, Any]) -> None:
    """Print the results of all policies."""
    word, num = summary["success"], summary["episodes"]
    heads = f"{word:>20}{'mean return':>14}{'mean duration':>16}{f'until {word}':>18}"
    print(f"\n{'policy':<12}{heads}")
    for name in ("learned", *summary["baselines"]):
        keys = ("success_rate", "mean_return", "mean_length_T", "mean_time_to_success_T")
        prefix = "" if name == "learned" else f"{name}_"
        rate, value, length, duration = (summary[prefix + key] for key in keys)
        shown = "-" if duration is None or math.isnan(duration) else f"{duration:.1f} T"
        share = find_share(round(rate * num), num).show(".0%")
        print(f"{name:<12}{share:>20}{value:>14.1f}{length:>14.1f} T{shown:>18}")
    minutes = f"{summary['wall_seconds'] / 60:.1f} minutes"
    print(f"({num} fixed starts; in brackets 95 % intervals of so few; {minutes})\n", flush=True)


def show_files(folder: Path, *, frames: int, modules: Sequence[str]) -> None:
    """Print the files of a run of so many frames, and commands to continue with.

    ``modules`` are those outside fishrl that the user has named.
    """
    for path in sorted(folder.iterdir()):
        if not path.name.startswith("."):
            print(f"  {path}")
    has_recording = (folder / "episode.rrd").is_file()
    policy = [f"policy={quote(f'{folder.parent}/{folder.name}')}", *show_modules(modules)]
    viewed = [str(folder)] if has_recording else policy
    print(f"\nevaluate: {show_command('evaluate', *policy)}")
    print(f"view: {show_command('view', *viewed)}")
    print(f"train longer: {show_resume(folder, modules)} total_frames={2 * frames}")


@program(command_line=TRAINING, sweep=sweep)
def main(settings: TrainConfig) -> None:
    """Begin or continue a run; print the command to resume it if it is interrupted."""
    opened = open_run(settings)
    if opened.summary is not None:
        print(f"{settings.path}: already finished; total_frames=... extends it")
        return
    with Progress() as progress:
        view = RunCallback(settings, progress)
        training = Training(opened, callbacks=[progress, view])
        folder = training.folder.path
        hint = f"resume with: {show_resume(folder, settings.modules)}"
        try:
            summary = complete(training)
        except Interrupted as end:
            frames = Checkpoint.read(training.folder.last).frames
            print(f"{end}: saved at frame {frames}; {hint}", file=sys.stderr)
            sys.exit(128 + end.number)
        except KeyboardInterrupt as end:
            print(f"interrupted; {hint}", file=sys.stderr)
            sys.exit(exit_status(end))
        except (OSError, ValueError) as error:
            error.add_note(hint)
            raise
    show_files(folder, frames=summary["frames"], modules=settings.modules)
