"""The pages of the frozen studies agree with their data, and their scripts can be read."""

import ast
import re

import pytest

from studies import claims
from studies.tables import STUDIES, TABLE, fill

NAMES = sorted(path.parent.name for path in STUDIES.glob("*/README.md"))


@pytest.mark.parametrize("study", NAMES)
def test_tables_follow_from_data(study: str) -> None:
    page = (STUDIES / study / "README.md").read_text(encoding="utf-8")
    assert page == fill(study), "run python studies/tables.py"
    data = {path.stem for path in (STUDIES / study / "data").glob("*.csv")}
    assert data == {name for _, name in TABLE.findall(page)}


@pytest.mark.parametrize("study", NAMES)
def test_page_has_picture_or_table_command_commit(study: str) -> None:
    page = (STUDIES / study / "README.md").read_text(encoding="utf-8")
    assert re.search(r"^!\[.+\]\(.+\.png\)$|^<!-- table: ", page, re.MULTILINE)
    assert re.search(r"^python (-m )?(experiments|tests|examples)[./]\w+", page, re.MULTILINE)
    assert re.search(r"commits? [0-9a-f]{7}\b", page)


@pytest.mark.parametrize("study", NAMES)
def test_scripts_import_public_names_only(study: str) -> None:
    for path in (STUDIES / study).glob("*.py"):
        nodes = ast.walk(ast.parse(path.read_text(encoding="utf-8"), filename=path.name))
        named = [a.name for n in nodes if isinstance(n, ast.ImportFrom) for a in n.names]
        assert not [name for name in named if name.startswith("_")], path


@pytest.mark.parametrize("study", [name for name in NAMES if hasattr(claims, f"check_{name}")])
def test_main_claim_follows_from_data(study: str) -> None:
    getattr(claims, f"check_{study}")()


def test_nothing_imports_the_studies() -> None:
    for folder in ("fishrl", "experiments", "examples"):
        for path in (STUDIES.parent / folder).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            assert not re.search(r"^\s*(from|import) studies\b", text, re.MULTILINE), path


def test_documentation_lists_every_study() -> None:
    appendix = (STUDIES.parent / "docs" / "studies.md").read_text(encoding="utf-8")
    assert set(re.findall(r"studies/(\w+)/README\.md", appendix)) == set(NAMES)
