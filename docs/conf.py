"""Sphinx settings of the documentation site; `make docs` builds it."""

import sys
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "src"), str(ROOT / "tools")]

import api_pages  # noqa: E402
import cli_page  # noqa: E402
import contract_page  # noqa: E402
import docstrings  # noqa: E402
import skill_tables  # noqa: E402
from marks import write_changed  # noqa: E402

import perdure  # noqa: E402

project = "perdure"
author = "the perdure authors"
copyright = "2026, the perdure authors"
version = release = perdure.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["_build"]
default_role = "py:obj"  # `Name` in a docstring becomes a link where that name is documented
nitpicky = False
suppress_warnings = ["ref.python"]  # two packages may each have a `World`; links of their docstrings may meet both

myst_heading_anchors = 4
myst_enable_extensions = ["deflist"]

autodoc_typehints_format = "short"
autodoc_member_order = "bysource"
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
napoleon_numpy_docstring = False
napoleon_use_rtype = False
copybutton_prompt_text = "$ "

html_theme = "pydata_sphinx_theme"
html_title = "perdure"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False
html_sidebars = {"**": ["globaltoc.html"]}  # every page, in the order of index.md
html_theme_options = {
    "navbar_center": [],
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": [],
    "secondary_sidebar_items": ["page-toc"],
}


def setup(app: Any) -> None:
    """Write the generated pages, and read docstrings as Markdown."""
    reference = ROOT / "docs" / "reference"
    api_pages.write(reference / "api")
    write_changed(reference / "cli.md", cli_page.page())
    write_changed(reference / "contract.md", contract_page.page())
    write_changed(ROOT / "docs" / "home" / "skills.md", skill_tables.page())
    app.connect("autodoc-process-docstring", docstrings.plain_attribute, priority=400)  # before Napoleon
    app.connect("autodoc-process-docstring", docstrings.process, priority=600)
    app.connect("autodoc-process-signature", docstrings.signature)
    app.connect("html-page-context", docstrings.short_arrays)
