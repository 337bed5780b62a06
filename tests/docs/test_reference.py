"""The configuration reference, made from the constructors."""

import importlib
import inspect
import re
from pathlib import Path

import pytest

from docs.reference import describe, list_programs, make_reference
from fishrl import physics
from fishrl.envs import KarmanGait, Predation
from fishrl.programs.train_settings import TRAINING
from fishrl.training.evaluation import FINAL_SEED, SELECTION_SEED
from tests.docs.pages import DOCS

SCHEMAS = {name: made.command_line.schema for name, made in list_programs().items()}


def test_every_argument_of_programs_and_tasks_has_its_row_with_words() -> None:
    page = make_reference()
    for kind in (*SCHEMAS.values(), Predation, KarmanGait):
        table = describe(kind)
        for name in inspect.signature(kind).parameters:
            (row,) = [line for line in table.splitlines() if line.startswith(f"| `{name}` |")]
            cells = row.replace("\\|", "").strip("|").split("|")
            assert len(cells) == 4 and all(cell.strip() for cell in cells), row
            assert row in page


def test_types_defaults_and_inherited_words_are_shown() -> None:
    table = describe(Predation)
    row = "| `body_length` | `int` | `50` | L in nodes"
    assert row in table  # the words of AbstractTask
    assert "| `domain_bl` | `tuple[float, float]` | `[10.0,5.0]` |" in table
    assert "| `stream` | `Stream` | `Stream(…)` |" in describe(KarmanGait)
    assert "| `name` | `str \\| None` | `null` |" in describe(SCHEMAS["fishrl train"])


def test_the_seeds_of_evaluations_are_those_of_the_training() -> None:
    said = f"{FINAL_SEED} gives those of every run's final evaluation, "
    said += f"{SELECTION_SEED} those that selected its checkpoint."
    for program in ("fishrl evaluate", "fishrl view"):
        assert said in describe(SCHEMAS[program])


def test_every_choice_is_listed_and_the_page_is_not_kept_in_the_repository() -> None:
    page = make_reference()
    for group, names in TRAINING.list_choices().items():
        assert f"| `{group}=` | " + ", ".join(f"`{name}`" for name in names) in page
    assert "docs/configuration.md" in (DOCS.parent / ".gitignore").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    "package", ["physics", "envs", "modules", "objectives", "training", "viewer"]
)
def test_every_public_name_is_on_an_api_page(package: str) -> None:
    module = importlib.import_module(f"fishrl.{package}")
    page = (DOCS / "api" / f"{package}.md").read_text(encoding="utf-8")
    shown = set(re.findall(r"automodule:: (\S+)", page))
    public = {name: getattr(module, name) for name in module.__all__}
    homes = {name: value.__module__ for name, value in public.items() if hasattr(value, "__name__")}
    lost = {name for name, home in homes.items() if not shown & {home, module.__name__}}
    assert homes and not lost, lost


def test_functions_that_the_theory_page_names_exist() -> None:
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
