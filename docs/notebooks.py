"""Tutorials as notebooks: text and code of a page, to run and to change."""

import re
from pathlib import Path

import nbformat

#: A block of code, and the comments above it that name its file or shorten it for tests.
BLOCK = re.compile(
    r"((?:^<!-- [^\n]* -->\n)*)^```(?:\{code-cell\} ipython3|python|yaml)\n(.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
FILE = re.compile(r"<!-- file: (\S+) -->")
#: Figures, and directives of the site.
NO_TEXT = re.compile(r"\A---\n.*?^---\n|^!\[.*?\]\(.*?\)$|^<!-- .*? -->$", re.MULTILINE | re.DOTALL)


def make_notebook(text: str) -> nbformat.NotebookNode:
    """Return a page as a notebook, in which code that belongs in a file writes it and runs it."""
    cells, end = [], 0

    def add_text(part: str) -> None:
        if words := NO_TEXT.sub("", part).strip():
            cells.append(nbformat.v4.new_markdown_cell(words))

    for match in BLOCK.finditer(text):
        add_text(text[end : match.start()])
        comments, code = match.groups()
        if file := FILE.search(comments):
            if folder := file.group(1).rpartition("/")[0]:
                cells.append(nbformat.v4.new_code_cell(f"!mkdir -p {folder}"))
            code = f"%%writefile {file.group(1)}\n{code}"
        cells.append(nbformat.v4.new_code_cell(code.strip()))
        if file and file.group(1).endswith(".py"):
            cells.append(nbformat.v4.new_code_cell(f"%run {file.group(1)}"))
        end = match.end()
    add_text(text[end:])
    for number, cell in enumerate(cells):
        cell["id"] = f"cell-{number}"  # by default drawn at random
    return nbformat.v4.new_notebook(cells=cells)


def offer_notebook(page: Path, text: str, folder: Path) -> str:
    """Write the notebook of a page into ``folder``; return the page with a link to it."""
    folder.mkdir(parents=True, exist_ok=True)
    nbformat.write(make_notebook(text), folder / f"{page.stem}.ipynb")
    link = f"[This page as a notebook](path:../static/notebooks/{page.stem}.ipynb)"
    return re.sub(r"^# .*$", rf"\g<0>\n\n{link}", text, count=1, flags=re.MULTILINE)
