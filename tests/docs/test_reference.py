"""The configuration reference, made from the classes of settings, and the API pages."""

import importlib
import re
from functools import cache
from pathlib import Path

import pytest

from docs.reference import describe, find_classes, find_programs, make_reference
from fishrl import physics
from fishrl.envs import KarmanGait, Predation
from fishrl.programs.train_settings import TRAINING
from fishrl.settings import list_fields
from fishrl.training import LearningSettings, RunSettings
from fishrl.training.evaluation import FINAL_SEED, SELECTION_SEED
from tests.docs.pages import DOCS

read_page = cache(make_reference)
SCHEMAS = {name: main.command_line.schema for name, main in find_programs().items()}


@pytest.mark.parametrize("kind", [*SCHEMAS.values(), Predation, KarmanGait])
def test_every_field_has_row_with_meaning(kind: type) -> None:
    rows = [row for base in kind.__mro__ if base in find_classes() for row in _list_rows(base)]
    for entry in list_fields(kind):
        row = next(row for row in rows if row.startswith(f"| `{entry.name}` |"))
        cells = row.replace("\\|", "").strip("|").split("|")
        assert len(cells) in (4, 5) and all(cell.strip() for cell in cells), row
        assert row in read_page()


def _list_rows(kind: type) -> list[str]:
    return [line for line in describe(kind).splitlines() if line.startswith("| `")]


def test_rows_show_types_bounds_defaults_roles() -> None:
    assert "| `time_limit` | `int, > 0` | `404` | decisions" in describe(KarmanGait)
    assert "| `stream` | `Stream` | `Stream(…)` |" in describe(KarmanGait)
    assert "| `gamma` | `float, ≥ 0, ≤ 1` | `0.99` | discount" in describe(LearningSettings)
    (row,) = [row for row in _list_rows(RunSettings) if row.startswith("| `name` |")]
    assert row.startswith("| `name` | `str \\| null` | `null` |")
    assert row.endswith("| what is logged, saved or shown |")


def test_documented_seeds_match_training() -> None:
    said = f"{FINAL_SEED} gives the starts of every run's final evaluation, "
    said += f"{SELECTION_SEED} those that selected its best checkpoint."
    for program in ("fishrl evaluate", "fishrl view"):
        assert any(said in describe(base) for base in SCHEMAS[program].__mro__[:-2])


def test_every_program_of_fishrl_has_a_section() -> None:
    missing = [name for name in SCHEMAS if f"### {name}\n" not in read_page()]
    assert not [name for name in missing if name.startswith("fishrl ")]


def test_every_choice_is_listed() -> None:
    for group, names in TRAINING.list_choices().items():
        assert f"| `{group}=` | " + ", ".join(f"`{name}`" for name in names) in read_page()


@pytest.mark.parametrize(
    "package", ["physics", "envs", "modules", "objectives", "training", "viewer"]
)
def test_public_names_are_on_api_pages(package: str) -> None:
    module = importlib.import_module(f"fishrl.{package}")
    page = (DOCS / "api" / f"{package}.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"automodule:: (\S+)", page))
    public = {name: getattr(module, name) for name in module.__all__}
    homes = {name: value.__module__ for name, value in public.items() if hasattr(value, "__name__")}
    lost = {name for name, home in homes.items() if not shown & {home, module.__name__}}
    assert homes and not lost, lost


def test_functions_named_in_theory_exist() -> None:
    text = (DOCS / "theory.md").read_text(encoding="utf-8")
    folder = Path(physics.__file__).parent
    paths = [path.relative_to(folder.parents[1]).with_suffix("") for path in folder.rglob("*.py")]
    modules = {path.name: ".".join(path.parts) for path in paths if path.parent.name != "fast"}
    named = [pair for pair in re.findall(r"`(\w+)\.([\w.]+)`", text) if pair[0] in modules]
    assert len(named) > 20
    for module, name in named:
        thing = importlib.import_module(modules[module])
        for part in name.split("."):
            fields = getattr(thing, "__dataclass_fields__", {})
            assert hasattr(thing, part) or part in fields, f"{module}.{name}"
            thing = getattr(thing, part, None)
