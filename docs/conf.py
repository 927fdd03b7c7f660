"""Sphinx: `make docs` builds the site into docs/site. Nothing in it is loaded from anywhere else."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "build_tools"), str(HERE.parent)]

from fingerflow import __version__  # noqa: E402

project = "fingerflow"
author = "the fingerflow developers"
copyright = "2026, the fingerflow developers"
version = release = __version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_nb",
    "mathml",  # these three are of build_tools
    "plain_docstrings",
    "generated_pages",
]
exclude_patterns = [".jupyter_cache", "site", "build_tools", "jupyter_execute"]

# Docstrings are plain text in which `this` is code.
default_role = "code"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True}
python_use_unqualified_type_names = True

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "cache"  # a notebook is run again when its cells have changed
nb_execution_in_temp = True
nb_execution_timeout = 600
nb_execution_raise_on_error = True
nb_execution_show_tb = True

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["equations.css"]
html_title = f"fingerflow {version}"
html_show_sphinx = False
html_copy_source = False
