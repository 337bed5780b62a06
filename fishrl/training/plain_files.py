"""Read stored YAML and JSON, which may hold anything, as plain data of a type."""

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field, JsonValue, TypeAdapter, ValidationError

#: Mapping of plain data: numbers, words, lists and mappings of them.
Tree = dict[str, JsonValue]
#: A number of frames or episodes.
Count = Annotated[int, Field(ge=0, lt=2**63)]


class Stored(BaseModel):
    """Base of the types of stored files; nothing is converted."""

    model_config = ConfigDict(strict=True)


class _PlainLoader(yaml.SafeLoader):
    """Reads YAML without aliases, of which a short file can make a tree without end."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            raise ValueError("it has aliases such as *name: write out what they stand for")
        return super().compose_node(parent, index)


def read_plain(path: Path, kind: Any, *, what: str) -> Any:
    """Read a ``.yaml`` or ``.json`` file and check its type.

    Args:
        path: of the file.
        kind: ``Tree``, a subclass of ``Stored``, or a mapping of words to these.
        what: what the file should hold, for messages.

    Raises:
        ValueError: in one line, for bytes that cannot be parsed, other types, deep nesting, and
            what ``check_words`` refuses.
        OSError: if the file cannot be read.
    """
    content = path.read_bytes()
    try:
        text = content.decode()
        tree = json.loads(text) if path.suffix == ".json" else yaml.load(text, _PlainLoader)
        check_words(tree)
        return TypeAdapter(kind).validate_python(tree)
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False, include_input=False)[0]
        reason = f"{'.'.join(map(str, first['loc'][:4])) or 'the whole'}: {first['msg']}"
    except Exception as error:  # noqa: BLE001 - odd bytes make a parser raise any
        is_clear = isinstance(error, ValueError | yaml.YAMLError)
        reason = str(error) if is_clear else "it cannot be parsed, or is nested too deeply"
    reason = " ".join(reason.split())[:300]
    raise ValueError(f"{path}: damaged or not {what} ({reason}); repair or delete it")


def check_words(value: Any) -> None:
    """Raise ValueError for numbers that are not finite and words that control a terminal.

    Args:
        value: nested plain data.
    """
    if isinstance(value, Mapping):
        value = [*value, *value.values()]
    for entry in value if isinstance(value, list) else ():
        check_words(entry)
    if isinstance(value, str) and not value.isprintable():
        raise ValueError(f"{value!r} is no word in one line")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{value} is not finite")
