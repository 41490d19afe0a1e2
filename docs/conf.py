"""Sphinx: `python -m sphinx -W -b html docs docs/_build`."""

from pygments.lexers.configs import TOMLLexer

from dmptm_ctrl import __version__
from dmptm_ctrl.effects import CATALOGUE

project = "dmptm-ctrl"
author = "the dmptm-ctrl developers"
release = version = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "numpydoc"]
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_missing"]  # links to files of the repository outside docs/
exclude_patterns = ["_build", "images/*.py"]
html_theme = "furo"
html_title = f"dmptm-ctrl {__version__}"
numpydoc_show_class_members = False
autodoc_typehints = "none"  # numpydoc gives types with their units


def catalogue_table():
    """Table of the effects, from the catalogue itself."""
    rows = ["| effect | where | parameters | shown by | source |", "|---|---|---|---|---|"]
    for name, effect in CATALOGUE.items():
        parameters = ", ".join(f"{p.name} [{p.unit or '1'}]" for p in effect.parameters)
        cells = (f"`{name}`", effect.location, parameters, effect.reveals, effect.source)
        rows.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(rows)


def put_catalogue(app, name, source):
    source[0] = source[0].replace("<!-- catalogue -->", catalogue_table())


def setup(app):
    app.add_lexer("toml-part", TOMLLexer)  # an example that is no whole rig
    app.connect("source-read", put_catalogue)
