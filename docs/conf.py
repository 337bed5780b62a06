"""How Sphinx builds these pages: ``make docs``."""

import json
import re
import sys
from pathlib import Path
from typing import Any

from docutils import nodes

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

from notebooks import offer_notebook  # noqa: E402
from reference import show_signature, write_reference  # noqa: E402
from task_reference import write_task_reference  # noqa: E402

import fishrl  # noqa: E402
from experiments.validate import CASES  # noqa: E402
from experiments.validation.report import render_case  # noqa: E402
from fishrl.settings import Settings  # noqa: E402

write_reference(HERE / "configuration.md")
write_task_reference(HERE / "task_reference.md")

project = "fishrl"
author = "fishrl developers"
copyright = author
release = version = fishrl.__version__

extensions = [
    "myst_nb",
    "mathml",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
source_suffix = {".md": "myst-nb", ".json": "myst-nb"}  # stored results of validation
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "force"
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_merge_streams = True
nb_output_stderr = "remove"  # warnings of packages, progress of the compiler
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
python_display_short_literal_types = True
python_maximum_signature_line_length = 100
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_ivar = True
napoleon_custom_sections = [("Terms", "params_style")]  # of a reward

html_math_renderer = "mathml"
html_theme = "furo"
html_title = f"fishrl {release}"
html_static_path = ["static"]
html_css_files = ["style.css"]


def skip(_app: Any, _what: str, _name: str, entry: Any, _skip: bool, _options: Any) -> bool | None:
    """Leave out the fields of named tuples, which the docstring of the class describes."""
    return True if (getattr(entry, "__doc__", "") or "").startswith("Alias for field") else None


def tidy(_app: Any, _what: str, _name: str, thing: Any, *rest: Any) -> tuple[str, str] | None:
    """Write signatures of settings without bounds, and ``...`` for what Sphinx cannot parse."""
    signature, annotation = rest[-2:]
    if isinstance(thing, type) and issubclass(thing, Settings) and thing is not Settings:
        return show_signature(thing), annotation
    return (signature.replace("<factory>", "..."), annotation) if signature else None


def keep_colon(_app: Any, what: str, *rest: Any) -> None:
    """Make a comment the first line of properties and constants.

    Napoleon reads a first line "Summary: details" as "type: description".
    """
    if what in ("attribute", "data", "property"):
        rest[-1][:0] = ["..", ""]


def drop_object(_app: Any, page: nodes.document) -> None:
    """Leave out the base of all classes."""
    for line in list(page.findall(nodes.paragraph)):
        if line.astext() == "Bases: object":
            line.parent.remove(line)


def link_studies(_app: Any, _page: str, source: list[str]) -> None:
    """Link Markdown outside the site, such as the studies' pages, as files."""
    source[0] = re.sub(
        r"\]\(((?:\.\./)+(?:studies/[^)]*|SECURITY)\.md)\)", r"](path:\1)", source[0]
    )


def add_validation(_app: Any, page: str, source: list[str]) -> None:
    """Make the page of a validation case from its stored results."""
    if page.startswith("validation/"):
        (case,) = [case for case in CASES if page == f"validation/{case.name}"]
        source[0] = render_case(case, json.loads(source[0]))


def add_notebooks(_app: Any, page: str, source: list[str]) -> None:
    """Offer each tutorial as a notebook, too."""
    if page.startswith("tutorials/"):
        folder = HERE / "static" / "notebooks"
        source[0] = offer_notebook(HERE / f"{page}.md", source[0], folder)


def setup(app: Any) -> None:
    """Connect the above."""
    app.connect("autodoc-skip-member", skip)
    app.connect("autodoc-process-signature", tidy)
    app.connect("autodoc-process-docstring", keep_colon, priority=400)
    app.connect("doctree-read", drop_object)
    app.connect("source-read", add_validation)
    app.connect("source-read", link_studies)
    app.connect("source-read", add_notebooks)
