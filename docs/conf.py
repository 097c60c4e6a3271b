"""Settings of the documentation's site: `make docs` builds it into docs/_build."""

from pathlib import Path

from typer import Context
from typer.cli import get_docs_for_click
from typer.main import get_command

from heliograph import __version__
from heliograph.cli import main

HERE = Path(__file__).parent

project = "Heliograph"
author = "The Heliograph authors"
version = release = __version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
exclude_patterns = ["_build", "vectors"]
html_theme = "furo"
html_title = "Heliograph"
html_show_copyright = False
nitpicky = False
# names in docstrings stand in single backticks
default_role = "code"
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True, "show-inheritance": False}
napoleon_google_docstring = False
napoleon_use_rtype = False


def _write_cli_reference() -> None:
    """Let Typer describe the command; each build makes the page again."""
    group = get_command(main.app)
    group.commands = {name: main.load_command(name) for name in main.COMMANDS}
    page = get_docs_for_click(obj=group, ctx=Context(group), name="heliograph")
    (HERE / "reference" / "cli.md").write_text(f"{page.strip()}\n")


_write_cli_reference()
