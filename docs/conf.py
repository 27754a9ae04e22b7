"""The site: `sphinx-build -W -n docs site` in a clone writes site/index.html, offline."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))  # the extensions that are here

project = "sweepopt"
copyright = "the sweepopt authors"
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "docstrings",
    "gallery",
    "mathml",
]
default_role = "code"
exclude_patterns = ["*_head.md"]

html_theme = "furo"
html_math_renderer = "mathml"
html_title = "sweepopt"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
smartquotes = False  # pages name options such as --set, to be copied

myst_enable_extensions = ["deflist", "dollarmath", "colon_fence"]
myst_heading_anchors = 3
nb_execution_mode = "off"  # notebooks show what is stored in them
nb_execution_raise_on_error = True  # of pages that ask to be run
nb_merge_streams = True
nb_execution_in_temp = True
nb_execution_timeout = 120

autodoc_member_order = "bysource"
autodoc_typehints = "none"  # the docstrings have types with shapes and units
napoleon_numpy_docstring = True
napoleon_google_docstring = False
napoleon_use_param = napoleon_use_rtype = napoleon_use_ivar = False
