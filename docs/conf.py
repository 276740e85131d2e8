"""Settings of the documentation: ``sphinx-build -W -b html docs docs/_build/html``."""

import sys
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError, latex2mathml
from sphinx.errors import SphinxError

sys.path.insert(0, str(Path(__file__).parents[1]))

project = "regrasp-opt"
author = "The regrasp-opt developers"
copyright = "the regrasp-opt developers"
version = release = "0.1.0"

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build", "paper"]
html_theme = "furo"
html_title = "regrasp-opt"
html_math_renderer = "mathml"

myst_enable_extensions = ["dollarmath", "amsmath", "tasklist"]
myst_heading_anchors = 3

autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_google_docstring = False
napoleon_use_ivar = True
napoleon_use_rtype = False


def write_math(translator: Any, node: nodes.Element) -> None:
    """Write a formula as MathML, which browsers draw themselves: the built pages load nothing from the network."""
    try:
        formula = latex2mathml.tex2mathml(node.astext(), as_block=isinstance(node, nodes.math_block))
    except MathError as error:
        raise SphinxError(f"the formula '{node.astext()}' cannot be written as MathML: {error}") from error
    translator.body.append(formula)
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Make `write_math` the renderer of formulas."""
    app.add_html_math_renderer("mathml", (write_math, None), (write_math, None))
