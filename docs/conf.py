"""Settings of the documentation's site: `make docs` builds it into docs/_build."""

import subprocess
import sys
from pathlib import Path

from heliograph import __version__

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
    """Let Typer describe the command; its output is made again with each build."""
    page = HERE / "reference" / "cli.md"
    command = [sys.executable, "-m", "typer", "heliograph.cli.main", "utils", "docs", "--name", "heliograph"]
    page.write_text(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


_write_cli_reference()
