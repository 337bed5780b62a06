"""What the programs share at the command line: settings in, plain words out."""

from __future__ import annotations

import logging
import os
import shlex
import shutil
import signal
import sys
import sysconfig
import traceback
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, cast

from tqdm import tqdm

if TYPE_CHECKING:
    from omegaconf import DictConfig

    from experiments.settings import EvaluateConfig, TrainConfig, ViewConfig
    from fishrl.training.loop import Training


def set_up_logging() -> None:
    """Print log lines above the bar, of TorchRL only warnings."""
    os.environ.setdefault("RL_LOGGING_LEVEL", "WARNING")  # read when torchrl is imported
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[_AboveBar()])


class _AboveBar(logging.Handler):
    """Writes lines without breaking the progress bar."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        tqdm.write(self.format(record), file=sys.stderr)


def read_arguments(program: str, arguments: Sequence[str]) -> list[str]:
    """Check a command line for hydra; print help where that is asked for, and end the program.

    Args:
        program: train, evaluate, view or train_lateral_line.
        arguments: the command line.
    """
    from experiments.config import check_overrides

    with plain_errors():
        show_help(program, arguments)
        return check_overrides(program, arguments)


def show_help(program: str, arguments: Sequence[str]) -> None:
    """Print help if a command line asks for it, and end the program."""
    rest = [argument for argument in arguments if argument not in ("--help", "-h")]
    if len(rest) < len(arguments):
        from experiments.usage import describe_program

        tqdm.write(describe_program(program, rest))
        sys.exit(0)


def show_command(module: str, *arguments: str) -> str:
    """Write a command of this Python as it has to be typed here."""
    here, on_path = Path(sys.executable), shutil.which("python")
    found = Path(on_path or "").absolute()
    # environments share one file by links, so their folders tell them apart
    if found.parent.resolve() == here.parent.resolve() and found.samefile(here):
        python = "python"
    elif here.is_relative_to(Path.cwd()):
        python = str(here.relative_to(Path.cwd()))
    else:
        python = str(here)
    return shlex.join([python, "-m", module, *arguments])


@contextmanager
def plain_errors() -> Iterator[None]:
    """End the program with the message alone where something was set wrongly, or by Ctrl-C.

    Errors that come from a user's own file name its line.
    """
    try:
        yield
    except (ValueError, ImportError, FileNotFoundError) as error:
        logging.getLogger(__name__).debug("where it came from:", exc_info=True)
        sys.exit(f"error: {error}{_say_place(error)}")
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(128 + signal.SIGINT)


def _say_place(error: Exception) -> str:
    """Name the line of a user's own file that an error comes from; nothing if it is from ours.

    What fishrl and the programs refuse is said in words that need no place.
    """
    here = Path(__file__).parent
    ours = (here, here.parent / "fishrl")
    libraries = tuple({path for name, path in sysconfig.get_paths().items() if "lib" in name})
    frames = [
        f for f in traceback.extract_tb(error.__traceback__) if not f.filename.startswith("<")
    ]

    def lies_in(frame: traceback.FrameSummary, folders: Iterable[str | Path]) -> bool:
        return any(Path(frame.filename).is_relative_to(folder) for folder in folders)

    own = [frame for frame in frames if not lies_in(frame, (*ours, *libraries))]
    if not own or lies_in(frames[-1], ours):
        return ""
    return f" ({own[-1].filename}:{own[-1].lineno}, in {own[-1].name})"


@contextmanager
def resumable(training: Training) -> Iterator[None]:
    """Save and say how to go on if the program is told to end, or cannot write any more."""
    from fishrl.training.interruption import Interrupted

    command = show_command("experiments.train", f"resume={training.folder.path}")
    hint = f"go on with: {command}"
    try:
        with training.interruption:
            yield
    except Interrupted as end:
        print(f"{end}: saved at frame {training.counters.frames}; {hint}", file=sys.stderr)
        sys.exit(128 + end.number)
    except KeyboardInterrupt:
        print(f"interrupted; {hint}", file=sys.stderr)
        sys.exit(128 + signal.SIGINT)
    except OSError as error:
        sys.exit(f"error: {error}\n{hint}")


def training_settings(config: DictConfig) -> TrainConfig:
    """Turn what hydra composed into settings; a resumed run brings its own."""
    from hydra.core.hydra_config import HydraConfig

    from experiments.config import resumed_settings, to_settings

    if config.get("resume"):
        given = [a for a in HydraConfig.get().overrides.task if not a.startswith("resume=")]
        settings = resumed_settings(config.resume, given)
        settings.resume = config.resume
        return settings
    return cast("TrainConfig", to_settings("train", config))


def evaluation_settings(config: DictConfig) -> EvaluateConfig:
    """Turn what hydra composed into settings; a checkpoint brings its task unless one is given."""
    from hydra.core.hydra_config import HydraConfig

    from experiments.config import to_settings

    settings = cast("EvaluateConfig", to_settings("evaluate", config))
    if settings.checkpoint is not None:
        bring_task(settings, settings.checkpoint, HydraConfig.get().overrides.task)
    return settings


def bring_task(
    settings: EvaluateConfig | ViewConfig, checkpoint: str, arguments: Sequence[str]
) -> None:
    """Take task and recognition from a checkpoint, each unless the command line names one.

    Settings of the task (``task.time_limit=40``) go on top of it.

    Args:
        settings: what is filled in.
        checkpoint: run folder or checkpoint.
        arguments: the command line.

    Raises:
        ValueError: if there is no checkpoint.
    """
    from experiments.config import change_task
    from fishrl.training.checkpoint import read_metadata
    from fishrl.training.recognition import find_machine

    given = [argument.lstrip("+") for argument in arguments]
    path, metadata = read_metadata(checkpoint)
    trained = metadata["config"]
    if not any(argument.startswith(("task=", "preset=")) for argument in given):
        settings.task = change_task(trained["task"], arguments)
        settings.preset = trained["preset"]
    is_given = any(argument.startswith("recognition=") for argument in given)
    if settings.recognition is None and not is_given:
        settings.recognition = find_machine(trained.get("recognition"), path)
