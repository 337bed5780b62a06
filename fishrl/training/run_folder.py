"""The folder of a run: paths of its files, their lock, and how they are read and written."""

from __future__ import annotations

import itertools
import json
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any, TextIO

import yaml
from pydantic import BaseModel, ConfigDict, Field, JsonValue, TypeAdapter, ValidationError

from fishrl.files import write_whole
from fishrl.locks import take_lock
from fishrl.training.interruption import Interrupted
from fishrl.training.recognition import FILE

#: Mapping of plain data: numbers, words, lists and mappings of them.
Tree = dict[str, JsonValue]
#: A number of frames or episodes.
Count = Annotated[int, Field(ge=0, lt=2**63)]


class Stored(BaseModel):
    """Base of the types of stored files; nothing is converted."""

    model_config = ConfigDict(strict=True)


#: For so long a lock may be held by a process that only looks whether it is free.
_LOOK_SECONDS = 0.5
#: What to do about a run that changed between two looks at it.
CHANGED = "another process has continued it meanwhile; repeat the command"


class HeldError(ValueError):
    """Another training writes the run."""


class RunFolder:
    """Paths of one run below ``path``."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.config = path / "config.yaml"  # the whole configuration, resolved
        self.metrics = path / "metrics.csv"  # one row per log step
        self.summary = path / "summary.json"  # the result of the run
        self.ending = path / ".ending"  # there while ``on_end`` of this result is not over
        self.last = path / "checkpoints" / "last"  # the newest, from which a run resumes
        self.best = path / "checkpoints" / "best"  # the one with the best evaluation
        self.failure = path / "failure.txt"  # why the run failed; the last line is the message
        self.lock = path / ".lock"  # locked by the process that writes the run, see ``hold``

    @classmethod
    def create(cls, *, parent: str, name: str, reuse: bool = False) -> RunFolder:
        """Make a new folder; if the name exists, a number is appended to it.

        With ``reuse`` a folder of that name is taken, or HeldError raised if it holds a run by now.
        """
        base = Path(parent).expanduser()
        paths = (base / (name if n == 1 else f"{name}-{n}") for n in itertools.count(1))
        while True:
            path = next(paths)
            try:
                with naming_folder(path):
                    path.mkdir(parents=True)
            except FileExistsError:
                if not reuse:
                    continue
                if cls(path).config.is_file():
                    raise HeldError(f"run folder {path}: {CHANGED}") from None
            return cls(path)

    @classmethod
    def of_existing(cls, path: str | Path) -> RunFolder:
        """Return the folder of an existing run; raise ValueError if it is none."""
        folder = cls(Path(path).expanduser())
        if not folder.config.is_file():
            refuse_many(folder.path, setting="resume")
            raise ValueError(
                f"resume = {path}: no config.yaml there; give the folder of a run, such as "
                "runs/predation-seed0"
            )
        return folder

    def has_begun(self) -> bool:
        """Return whether there is anything to resume: a checkpoint, or frames without one."""
        left = "..*"  # by a process that was killed while writing a checkpoint
        if any(not path.match(left) for path in self.last.parent.glob("*")):
            return True
        return self.metrics.is_file() and len(self.metrics.read_bytes().splitlines()) > 1

    def hold(self) -> TextIO:
        """Lock the run until the file is closed or the process ends, or raise HeldError."""
        with naming_folder(self.path):
            file = self.lock.open("a")
        deadline = time.monotonic() + _LOOK_SECONDS
        while not take_lock(file):
            if time.monotonic() > deadline:
                file.close()
                raise HeldError(
                    f"run folder {self.path}: another training writes it; wait for it or end it"
                )
            time.sleep(0.01)
        return file

    @contextmanager
    def noting_failure(self) -> Iterator[None]:
        """Write an error that occurs inside to ``failure.txt``; an interruption does not count."""
        self.failure.unlink(missing_ok=True)
        try:
            yield
        except (HeldError, Interrupted):
            raise
        except Exception:
            with suppress(OSError):  # a full disk must not hide the error
                write_whole(self.failure, traceback.format_exc())
            raise


@contextmanager
def naming_folder(path: Path, *, setting: str = "folder") -> Iterator[None]:
    """Raise ValueError, with a remedy, for a folder that the system does not let be made."""
    try:
        yield
    except FileExistsError:
        raise
    except OSError as error:
        raise ValueError(
            f"folder {path}: cannot be written ({error.strerror}); give another {setting}=..., "
            "or change its permissions"
        ) from error


def refuse_many(folder: Path, *, setting: str) -> None:
    """Raise ValueError for a folder of runs where a single run is meant, naming one of them."""
    held = sorted(folder.glob("*/config.yaml"))
    if held and not RunFolder(folder).config.is_file():
        raise ValueError(
            f"{setting} = {folder}: holds runs; name one of them, such as {held[0].parent}"
        )


def read_plain(path: Path, kind: Any, *, what: str) -> Any:
    """Read a ``.yaml`` or ``.json`` file of a type: ``Tree``, ``Stored``, or a mapping to these.

    Raises:
        ValueError: for bytes that cannot be parsed and for other types, naming ``what``.
        OSError: if the file cannot be read.
    """
    try:
        text = path.read_text(encoding="utf-8")
        tree = json.loads(text) if path.suffix == ".json" else yaml.safe_load(text)
        return TypeAdapter(kind).validate_python(tree)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        reason = f"{'.'.join(map(str, first['loc'][:4])) or 'the whole'}: {first['msg']}"
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        reason = str(error)
    reason = " ".join(reason.split())[:300]
    raise ValueError(f"{path}: damaged or not {what} ({reason}); repair or delete it")


def read_config(path: Path) -> dict[str, Any]:
    """Read the ``config.yaml`` of a run; raise ValueError if it holds no settings."""
    config = read_plain(path, Tree, what="the configuration of a run")
    return complete_settings(config, path.parent)


def complete_settings(config: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return stored settings of a run with the path of its classifier, wherever the run lies now.

    ``folder`` is the run's, or one of its checkpoints. Tasks of version 0.3.0 and before, which
    name no levels, have one.
    """
    whole, task, named = dict(config), config.get("task"), config.get("recognition")
    if isinstance(task, Mapping):
        whole["task"] = {"levels": 1, **task}
    if isinstance(named, Mapping) and named.get("path") == FILE:
        places = [place / FILE for place in (folder, *folder.resolve().parents[:2])]
        file = next((path for path in places if path.is_file()), places[0])
        whole["recognition"] = {**named, "path": str(file)}
    return whole


def read_summary(path: Path) -> dict[str, Any]:
    """Read the ``summary.json`` of a run, {} without one; raise ValueError if it is damaged."""
    return read_plain(path, Tree, what="the summary of a run") if path.is_file() else {}


def write_json(path: Path, values: Mapping[str, Any] | Sequence[Any]) -> None:
    """Write nested numbers and words; NaN and infinities, which JSON lacks, become null."""
    write_whole(path, TypeAdapter(Any).dump_json(values, indent=2).decode() + "\n")


def write_yaml(path: Path, values: Mapping[str, Any]) -> None:
    """Write nested settings."""
    write_whole(path, yaml.safe_dump(dict(values), sort_keys=False, allow_unicode=True))
