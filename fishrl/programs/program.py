"""Programs: functions called with arguments given as ``key=value``; errors take one line.

The signature of a function is the command line of its program::

    @program(evaluate, groups={"task": "predation", "preset": None})
    def main(*, save: str | None = None, **given: Any) -> None: ...

``fishrl evaluate policy=random task.reynolds=400`` checks the arguments of ``main`` and of
``evaluate``, and calls ``main``. ``--help`` prints the docstring of the module and, from ``Args:``,
the meaning of all arguments, ``--cfg job`` their values as YAML. ``ValueError``, ``ImportError``
and ``OSError`` end the program with one line. In Python, ``main.read([...])`` returns the settings
of a command line and ``main.run(settings)`` runs them.
"""

import gc
import inspect
import json
import logging
import os
import re
import select
import shlex
import shutil
import signal
import sys
import sysconfig
import traceback
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from textwrap import fill
from types import FrameType
from typing import Any, NoReturn, TypeVar

import torch
import yaml
from pydantic import AfterValidator
from tqdm import tqdm

from fishrl.programs.configuration import CommandLine, split_options
from fishrl.settings import REQUIRED, TARGET, Settings, build, describe, list_fields, to_plain
from fishrl.settings.base import find_schema
from fishrl.settings.plain import list_classes, list_words
from fishrl.training.interruption import exit_status, handling_signals

S = TypeVar("S", bound=Settings)

#: Layout of the lines of the help.
_WIDTH: dict[str, Any] = {"width": 100, "initial_indent": "  ", "subsequent_indent": " " * 8}


@dataclass(frozen=True)
class Program:
    """A function, run from the command line; ``sweep`` runs ``--multirun``."""

    function: Callable[..., None]
    command_line: CommandLine
    sweep: Callable[[Sequence[str]], None] | None = None

    def run(self, settings: Any) -> None:
        """Call the function with the settings of a command line."""
        if _takes_object(self.function):
            self.function(settings)
        else:
            self.function(**vars(settings))

    def read(self, arguments: Sequence[str] = ()) -> Any:
        """Return the settings of a command line; see ``CommandLine.read``."""
        return self.command_line.read(arguments)

    def __call__(self, arguments: Sequence[str] | None = None) -> None:
        """Run a command line, by default that of the process."""
        if not gc.isenabled():
            gc.freeze()  # what imports made is kept to the end
            gc.enable()
        words = list(sys.argv[1:] if arguments is None else arguments)
        generators = torch.random.fork_rng(devices=[])
        with generators, set_up_logging(), plain_errors(), handling_signals(interrupt):
            options = split_options(words)
            if options.help:
                print(self.describe(words))
            elif options.cfg:
                settings = describe(self.read(words))
                print(yaml.safe_dump({n: v for n, v in settings.items() if n != TARGET}))
            elif not options.multirun:
                self.run(self.read(words))
            elif self.sweep is not None:
                self.sweep(words)
            else:
                raise ValueError("--multirun: only fishrl train runs sweeps")

    def describe(self, arguments: Sequence[str] = ()) -> str:
        """Return the help: the module's docstring, choices and settings with their defaults."""
        line = self.command_line
        lines = [(sys.modules[self.function.__module__].__doc__ or "").strip(), ""]
        for name, choices in line.list_choices(arguments).items():
            lines.append(f"{name}: one of {', '.join(choices)}")
        if line.groups:
            lines.append("--config-dir <folder>: adds your own, <folder>/task/<name>.yaml")
            lines.append("modules=[...]: modules that define tasks, algorithms, loggers of yours")
            lines.append("")
        lines.append("settings, as key=value:")
        texts = read_arguments(line.schema)
        hints = {entry.name: entry.type for entry in list_fields(line.schema)}
        for name, value in self.list_defaults(arguments).items():
            lines += _list_settings(name, value, texts.get(name, ""), hints[name])
        return "\n".join(lines).replace("``", "`")

    def list_defaults(self, arguments: Sequence[str] = ()) -> dict[str, Any]:
        """Return the values of all settings with a command line that need not be complete."""
        node, modules = self.command_line.compose(arguments)
        values = {}
        for name, hint, default, _ in list_fields(self.command_line.schema):
            value = node.get(name, default)
            if isinstance(value, Mapping):
                value = build(tuple(list_classes(hint)), value, modules=modules)
            values[name] = value
        return values


def program(
    *parts: Callable[..., Any],
    without: tuple[str, ...] = (),
    command_line: CommandLine | None = None,
    sweep: Callable[[Sequence[str]], None] | None = None,
    **line: Any,
) -> Callable[[Callable[..., None]], Program]:
    """Make a program of a function, whose arguments are its settings.

    A function of one object of settings gets that object; any other its arguments by name, and the
    arguments of ``parts`` as ``**given``.

    Args:
        *parts: functions and classes of settings whose arguments are settings of the program, too.
        without: arguments of ``parts`` that are not settings.
        command_line: the command line, where it is known already.
        sweep: runs ``--multirun``.
        **line: arguments of ``CommandLine``.
    """

    def make(function: Callable[..., None]) -> Program:
        if command_line is not None:
            return Program(function, command_line, sweep)
        name = function.__module__.rpartition(".")[2].replace("_", "-")
        if _takes_object(function):
            (schema, *_) = typing.get_type_hints(function).values()
        else:
            bases = tuple(find_schema(part, without=without) for part in parts) or (Settings,)
            schema = find_schema(function, bases=bases)
        return Program(function, CommandLine(name=name, schema=schema, **line), sweep)

    return make


def _takes_object(function: Callable[..., None]) -> bool:
    first = next(iter(inspect.signature(function).parameters.values()))
    return first.kind is first.POSITIONAL_OR_KEYWORD


def ending_in(*endings: str) -> AfterValidator:
    """Return the check of a setting that names a file with one of some endings."""

    def check(path: str) -> str:
        if not path.endswith(endings):
            raise ValueError(f"a file that ends in one of {', '.join(endings)}")
        return path

    return AfterValidator(check)


def take(kind: type[S], given: dict[str, Any]) -> S:
    """Take the settings of a class out of arguments, and return its object."""
    return kind(**{entry.name: given.pop(entry.name) for entry in list_fields(kind)})


def _list_settings(key: str, value: Any, text: str, hint: Any) -> Iterator[str]:
    """List a setting and the settings of its object, with their meanings."""
    if len(words := list_words(hint)) > 1:
        text = f"{text} ({key}={'|'.join(words)})"
    plain = "???" if value is REQUIRED else to_plain(value)
    if not isinstance(plain, dict) or TARGET not in plain:
        yield fill(f"{key}={write_value(plain)}  {text}", **_WIDTH)
        return
    yield fill(f"{key}._target_={plain[TARGET]}  {text}", **_WIDTH)
    texts = read_arguments(type(value))
    for name, below, *_ in list_fields(type(value)):
        text = texts.get(name, "")
        yield from _list_settings(f"{key}.{name}", getattr(value, name), text, below)


def write_value(value: Any) -> str:
    """Write a plain value as on a command line."""
    if isinstance(value, bool) or value is None:
        return json.dumps(value)
    if isinstance(value, Mapping):
        return f"{{{','.join(f'{name}:{write_value(entry)}' for name, entry in value.items())}}}"
    if isinstance(value, list | tuple):
        return f"[{','.join(map(write_value, value))}]"
    return str(value)


def read_arguments(kind: type) -> dict[str, str]:
    """Return the entries of ``Args:`` in the docstrings of a class and its bases, by argument."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        doc, name = inspect.cleandoc(base.__doc__ or ""), ""
        match = re.search(r"^Args:\n((?:(?: .*)?\n?)*)", doc, re.MULTILINE)
        for line in match.group(1).splitlines() if match else ():
            begins = re.match(r" {4}\*{0,2}(\w+): (.*)", line)
            if begins:
                name = begins.group(1)
                texts[name] = begins.group(2)
            elif name and line.strip():
                texts[name] += " " + line.strip()
    return texts


@contextmanager
def set_up_logging() -> Iterator[None]:
    """Print log lines above the progress bar; TorchRL logs warnings only. Restores what was set."""
    root, name = logging.getLogger(), "RL_LOGGING_LEVEL"
    loggers = root, logging.getLogger("torchrl"), logging.getLogger("hydra")
    levels, handlers = [logger.level for logger in loggers], list(root.handlers)
    is_given = name in os.environ
    level = os.environ.setdefault(name, "WARNING")  # for other processes, too
    loggers[1].setLevel(level)
    logging.basicConfig(level=logging.INFO, format="%(message)s", handlers=[_AboveBar()])
    loggers[2].setLevel(logging.CRITICAL)  # its errors are raised too
    try:
        yield
    finally:
        root.handlers[:] = handlers
        for logger, former in zip(loggers, levels, strict=True):
            logger.setLevel(former)
        if not is_given:
            del os.environ[name]


class _AboveBar(logging.Handler):
    def emit(self, record: logging.LogRecord) -> None:
        tqdm.write(self.format(record), file=sys.stderr)


def show_command(program: str, *arguments: str) -> str:
    """Return the shell command that runs a program with this Python in this folder.

    Args:
        program: one of ``fishrl``, such as ``train``, or a module like ``experiments.validate``.
        *arguments: words that follow it.
    """
    here, on_path = Path(sys.executable), Path(shutil.which("python") or "")
    folder = here.parent
    folder = folder.relative_to(Path.cwd()) if folder.is_relative_to(Path.cwd()) else folder
    is_active = on_path.parent == here.parent
    if "." in program:
        start = ["python" if is_active else str(folder / here.name), "-m", program]
    else:
        start = ["fishrl" if is_active else str(folder / "fishrl"), program]
    return shlex.join([*start, *arguments])


def interrupt(number: int, frame: FrameType | None) -> NoReturn:
    """Raise KeyboardInterrupt with the number of a signal, so that the program cleans up."""
    raise KeyboardInterrupt(number)


@contextmanager
def plain_errors() -> Iterator[None]:
    """End the program with one line for a user error, and with status 130 for Ctrl-C.

    An error raised in a user's own file names its line. Other errors keep their traceback, and so
    do all if the environment variable ``FISHRL_DEBUG`` is set.
    """
    try:
        yield
        sys.stdout.flush()
    except (ValueError, ImportError, OSError) as error:
        if isinstance(error, BrokenPipeError) and _is_unread():
            sys.exit(128 + signal.SIGPIPE)
        if os.environ.get("FISHRL_DEBUG"):
            raise
        said = "\n".join([f"error: {error}{_find_line(error)}", *getattr(error, "__notes__", ())])
        sys.exit(said)
    except KeyboardInterrupt as end:
        print("interrupted", file=sys.stderr)
        sys.exit(exit_status(end))


def _is_unread() -> bool:
    """Return whether nobody reads the output any more, as after ``head``, and then drop it."""
    pipe = select.poll()
    pipe.register(sys.stdout, 0)
    is_unread = any(event & select.POLLERR for _, event in pipe.poll(0))
    if is_unread:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return is_unread


def _find_line(error: Exception) -> str:
    """Return the line of the user's file that raised an error; nothing for errors of fishrl."""
    root = Path(__file__).parents[2]
    ours = [root / "experiments", root / "fishrl"]
    libraries = [Path(path) for name, path in sysconfig.get_paths().items() if "lib" in name]

    def lies_in(frame: traceback.FrameSummary, folders: Iterable[Path]) -> bool:
        return any(Path(frame.filename).is_relative_to(folder) for folder in folders)

    frames = traceback.extract_tb(error.__traceback__)
    files = [frame for frame in frames if not frame.filename.startswith("<")]
    own = [frame for frame in files if not lies_in(frame, [*ours, *libraries])]
    if not own or lies_in(files[-1], ours):
        return ""
    return f" ({own[-1].filename}:{own[-1].lineno}, in {own[-1].name})"
