"""Sphinx: `make docs` builds the site into docs/site. Nothing in it is loaded from anywhere else."""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "build_tools"), str(HERE.parent)]

from gallery_folder import copy_scripts  # noqa: E402

from fingerflow import __version__  # noqa: E402

project = "fingerflow"
author = "the fingerflow developers"
copyright = "2026, the fingerflow developers"
version = release = __version__

extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "myst_parser",
    "sphinx_gallery.gen_gallery",
    "mathml",  # these three, and `gallery_folder`, are of build_tools
    "plain_docstrings",
    "generated_pages",
]
exclude_patterns = ["site", "build_tools", "gallery", "release", "generated/scripts", "generated/tables"]

# Docstrings are plain text in which `this` is code.
default_role = "code"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Convention", "params_style")]
napoleon_use_rtype = False
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True}
python_use_unqualified_type_names = True

myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
sphinx_gallery_conf = {
    "examples_dirs": copy_scripts(),
    "gallery_dirs": "generated/gallery",  # a script is run again when it has changed
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "capture_repr": (),
    "remove_config_comments": True,
    "show_memory": False,
    "write_computation_times": False,
    "reset_modules": ("gallery_folder.remove_recordings",),
    "reset_modules_order": "both",
}

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["equations.css"]
html_title = f"fingerflow {version}"
html_show_sphinx = False
html_copy_source = False
