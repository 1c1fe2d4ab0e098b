# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of Sphinx for the documentation site; docs/make_site.py uses them."""

import re

from gnuradio.wiforce._config import VERSION

project = "gr-wiforce"
author = "gr-wiforce"
project_copyright = "gr-wiforce, GPL-3.0-or-later"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
html_theme = "sphinx_rtd_theme"
html_theme_options = {"navigation_depth": 3}
version = release = VERSION
html_title = f"gr-wiforce {VERSION}"
html_copy_source = False
html_static_path = ["static"]
html_css_files = ["site.css"]

# Links to headings of other pages, as on every forge.
myst_heading_anchors = 4

napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_member_order = "bysource"
autodoc_typehints = "none"


def escape_bars(app, what, name, obj, options, lines):
    """Docstrings write magnitudes as |x|, which reStructuredText takes for a substitution."""
    lines[:] = [line if "``" in line else re.sub(r"(?<!\\)\|", r"\\|", line) for line in lines]


def setup(app):
    app.connect("autodoc-process-docstring", escape_bars)
