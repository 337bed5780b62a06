"""Every command on README and pages is parsed by its program, without running it."""

import argparse
import re
import shlex
import tomllib
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path

import pytest

from fishrl.__main__ import list_programs
from fishrl.programs.program import Program
from fishrl.programs.sweeps.jobs import plan_jobs
from fishrl.programs.train_settings import TRAINING
from fishrl.training.checkpoint import save_checkpoint
from fishrl.training.policy_spec import PolicySpec
from fishrl.training.run_folder import RunFolder, write_yaml
from tests.docs.pages import DOCS, PAGES, read_blocks

ROOT = DOCS.parent
PROGRAM = re.compile(
    r"(?:\bpython (?:-m )?(?=experiments\.|examples/)|"
    rf"(?:^|`)(?=fishrl (?:{'|'.join(list_programs())})\b))"
    r"(experiments\.[\w.]*|examples/\w+\.py|fishrl [a-z-]+)([^`\n|]*)",
    re.MULTILINE,
)
TARGET = re.compile(r"(?:^|`)make ([a-z-]+)(?![\w ]*=\d)", re.MULTILINE)
EXTRA = re.compile(r"pip install [^\n`]*\[([\w-]+)\]")
#: Runs that the pages mention, with their settings.
RUNS = {
    "runs/name": [],
    "runs/predation-seed0": [],
    "runs/predation/seed_0": [],
    "runs/gait-run": ["preset=gait_small", "recognition=oracle"],
    "runs/memory/latest_0": [
        *("preset=gait_small", "task=karman_gait_direct"),
        "task.stream.changes={_target_:fishrl.envs.changes.StreamSwitches,interval_T:10}",
    ],
    "runs/gammas/gamma_0.99-seed_1": ["gamma=0.99", "seed=1"],
    "runs/predation-boltzmann-seed0": ["algorithm._target_=boltzmann.Boltzmann"],
    "runs/holdstation-seed0": ["--config-dir=my_fish/conf", "task=hold_station"],
    "runs/state": ["preset=gait_bend"],
    "its-folder": [],
}


def _list_commands() -> list[tuple[str, str, str]]:
    """Return module and arguments of every command, and the first page that shows it."""
    found: dict[tuple[str, str], str] = {}
    for page in PAGES:
        text = re.sub(r"\\\n\s*", "", page.read_text(encoding="utf-8"))
        name = page.relative_to(ROOT).as_posix()
        for module, rest in PROGRAM.findall(text):
            found.setdefault((module, rest.partition(" #")[0].strip()), name)
    return sorted((name, *command) for command, name in found.items())


COMMANDS = _list_commands()


class _Read(BaseException):
    """Raised when a program has parsed its command line."""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Change to a folder with the runs, tasks and algorithms that the pages mention."""
    folder = tmp_path_factory.mktemp("home")
    for page in ("tutorials/new_task.md", "algorithms.md"):
        for block in filter(lambda block: block.file, read_blocks(page)):
            path = folder / "my_fish" / block.file
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.code, encoding="utf-8")
    (folder / "experiments").symlink_to(ROOT / "experiments")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.syspath_prepend(folder / "my_fish")
        _write_runs()
        yield folder


def _write_runs() -> None:
    for name, settings in RUNS.items():
        run = RunFolder(Path(name))
        run.best.parent.mkdir(parents=True)
        plan = TRAINING.read(settings)
        write_yaml(run.config, plan.to_config())
        spec = PolicySpec.for_task(plan.task)
        save_checkpoint(run.best, {}, spec=spec, frames=0, config=plan.to_config())


def _split(line: str, home: Path) -> list[str]:
    """Split a command line as a shell does, with ``<name>`` replaced by ``name``."""
    line = re.sub(r"<([^>]+)>", lambda match: match[1].replace(" ", "-"), line)
    words = [word for word in shlex.split(line, comments=True) if word != "..."]
    return [word.replace("~", str(home)) for word in words]


def _parse(main: Callable[[], None], words: list[str], patch: pytest.MonkeyPatch) -> None:
    """Let a program parse its command line with argparse, and stop it there."""
    parse = argparse.ArgumentParser.parse_args

    def stop(parser: argparse.ArgumentParser, *_: object) -> None:
        parse(parser, words)
        raise _Read

    patch.setattr(argparse.ArgumentParser, "parse_args", stop)
    with pytest.raises(_Read):
        main()


@pytest.mark.parametrize(("page", "module", "line"), COMMANDS)
def test_documented_command_is_parsed(
    page: str, module: str, line: str, home: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = _split(line, home)
    name = module.replace("fishrl ", "fishrl.programs.").replace("-", "_")
    main = import_module(name.removesuffix(".py").replace("/", ".")).main
    if not isinstance(main, Program):
        _parse(main, words, monkeypatch)
    elif "--multirun" in words:
        others = [word for word in words if not word.startswith("seed=")]
        plan_jobs([*others, "seed=1"])  # one seed stands for all
    elif "--help" not in words:
        main.read(words)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_documented_targets_and_extras_exist(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for target in TARGET.findall(text):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"make {target}"
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    for extra in EXTRA.findall(text):
        assert extra in extras["optional-dependencies"], extra
