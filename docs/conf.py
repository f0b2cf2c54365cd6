"""Settings of Sphinx: `make docs` writes the site to build/docs, warnings as errors, and runs the examples."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

from servocore import __version__

if TYPE_CHECKING:
    from sphinx.application import Sphinx

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent

project = "servocore"
author = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["authors"][0]["name"]
copyright = author  # noqa: A001, the name that Sphinx asks for
version = release = __version__

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.doctest",
    "sphinx_copybutton",
    "sphinx_gallery.gen_gallery",
]
root_doc = "index"
templates_path = ["_templates"]
exclude_patterns = ["site/sidebar.md", "gallery/README.*", "gallery/*.ipynb", "gallery/*.py", "gallery/*.md5"]
html_theme = "furo"
html_title = f"servocore {__version__}"
html_show_sourcelink = False

# Pages link to headings as Git servers name them.
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]

autosummary_generate = True
autodoc_typehints = "none"  # the docstrings give types together with shapes and units
default_role = "py:obj"
numpydoc_show_class_members = False  # templates/autosummary/class.rst lists them

sphinx_gallery_conf = {
    "examples_dirs": [str(ROOT / "examples")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"\.py$",
    "abort_on_example_error": True,
    "download_all_examples": False,
    "show_memory": False,
    "show_signature": False,
    "capture_repr": (),
    "within_subsection_order": "FileNameSortKey",
}

suppress_warnings = ["config.cache"]  # sphinx-gallery's settings hold functions, which are not kept from build to build

# Examples in docstrings write their files to where they run; warnings of the library are part of no answer.
doctest_global_setup = """
import os, tempfile
os.chdir(tempfile.mkdtemp())
"""

OUTSIDE = {"README": "site/readme", "CONTRIBUTING": "site/contributing", "CHANGELOG": "site/changelog"}
"""Pages above this folder, and the pages of the site that include them."""


def with_site_links(_app: Sphinx, page: str, source: list[str]) -> None:
    """Turn links out of this folder into links to pages of the site, and give the front page its sidebar."""
    up = "../" * page.count("/")
    for outside, inside in OUTSIDE.items():
        source[0] = source[0].replace(f"]({up}../{outside}.md", f"]({up}{inside}.md")
    if page == root_doc:
        source[0] += (DOCS / "site" / "sidebar.md").read_text(encoding="utf-8")


def setup(app: Sphinx) -> None:
    """Let the site see the pages as they are read on a Git server."""
    app.connect("source-read", with_site_links)
