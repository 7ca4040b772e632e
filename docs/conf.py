"""The documentation site: `sphinx-build -W docs docs/_build/html`."""

from __future__ import annotations

import os

# For the notebooks' kernels, whatever the caller has set: with another backend no figure would be on their pages.
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"

import sapopt

project = "sapopt"
author = "The sapopt developers"
copyright = "the sapopt developers; Apache License 2.0"
version = release = sapopt.__version__

extensions = ["myst_nb", "numpydoc", "sphinx.ext.autodoc", "sphinx.ext.mathjax", "sphinx.ext.viewcode"]
exclude_patterns = ["_build", "**.ipynb_checkpoints"]

# Pages are Markdown; those with a kernel in their header are notebooks and run while the site is built.
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
nb_execution_mode = "cache"
nb_execution_timeout = 900  # a cell takes seconds on an idle machine, but test machines are shared
nb_execution_raise_on_error = True
nb_execution_show_tb = True
nb_merge_streams = True

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings give types with shapes and units
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
default_role = "code"  # `name` in docstrings, as in the code

html_theme = "furo"
html_title = f"sapopt {release}"
html_theme_options = {"navigation_with_keys": True}
html_show_sphinx = False
html_static_path = ["_static"]
html_css_files = ["site.css"]
