"""Read stored YAML and JSON as plain data of a type."""

import json
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
