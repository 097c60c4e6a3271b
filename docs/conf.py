"""Settings of the documentation's site: `make docs` builds it into docs/_build."""

import re
from pathlib import Path
from typing import Any

from docutils import nodes
from numpy.typing import ArrayLike
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.util.typing import stringify_annotation
from typer import Context
from typer.cli import get_docs_for_click
from typer.main import get_command

from heliograph import __version__
from heliograph.cli import main
from heliograph.web.replay import recorded_page

HERE = Path(__file__).parent

project = "Heliograph"
author = "The Heliograph authors"
version = release = __version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["_build", "_extra", "jupyter_execute", "vectors", "**.ipynb_checkpoints"]
html_theme = "furo"
html_title = "Heliograph"
html_show_copyright = False
nitpicky = False
# names in docstrings stand in single backticks
default_role = "code"
# options keep both hyphens; blocks of code name their language
smartquotes = False
highlight_language = "none"
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath"]
# notebooks are stored with their outputs; tests/docs/test_pages.py runs them
nb_execution_mode = "off"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True}
python_maximum_signature_line_length = 88
napoleon_google_docstring = False
napoleon_use_rtype = False


def _write_cli_reference() -> None:
    """Let Typer describe the command; each build makes the page again."""
    group = get_command(main.app)
    group.commands = {name: main.load_command(name) for name in main.COMMANDS}
    page = get_docs_for_click(obj=group, ctx=Context(group), name="heliograph")
    (HERE / "reference" / "cli.md").write_text(f"{page.strip()}\n")


_write_cli_reference()
(HERE / "_extra").mkdir(exist_ok=True)
(HERE / "_extra" / "replay.html").write_text(recorded_page(), encoding="utf-8")
html_extra_path = ["_extra"]
html_static_path = ["_static"]
html_css_files = ["scheme.css"]

ARRAY_LIKE = re.sub(r"~[\w.]*\.(\w+)", r"\1", stringify_annotation(ArrayLike, "smart"))
"""NumPy's definition of `ArrayLike`, as autodoc shows it."""

ARRAY = re.compile(r"(?:numpy\.)?ndarray\[tuple\[Any, \.\.\.\], (?:numpy\.)?dtype\[(?:numpy\.)?(\w+)\]\]")
"""NumPy's definition of `NDArray[...]`."""


MODULE = re.compile(r"\b(?:heliograph|collections|pathlib|typing|numpy)\.(?:[a-z_]+\.)*(?=[A-Z])")
"""Path of a module before a type."""


def _short_types(_app: Sphinx, doctree: nodes.document) -> None:
    """Write `ArrayLike` and `NDArray[...]` in place of their definitions."""
    for signature in doctree.findall(addnodes.desc_signature):
        for node in list(signature.findall()):
            is_type = isinstance(node, addnodes.desc_annotation | addnodes.desc_returns) or (
                isinstance(node, addnodes.desc_sig_name) and isinstance(node.parent, addnodes.desc_parameter)
            )
            if is_type:
                text = "".join(child.astext() for child in node.children)
                short = ARRAY.sub(r"NDArray[\1]", text.replace(ARRAY_LIKE, "ArrayLike"))
                if short != text:
                    node.children = []
                    node += nodes.Text(short)


SECTION = re.compile(r"-+")

returned: dict[str, list[str]] = {}
"""Lines of the field "returns" by name of the function."""


def _take_returns(_app: Sphinx, _what: str, name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Take the paragraph below "Returns" out: Napoleon shows each of its lines as a value."""
    for at, title in enumerate(lines[:-2]):
        if title in ("Returns", "Yields") and SECTION.fullmatch(lines[at + 1]):
            end = next((k for k in range(at + 2, len(lines)) if not lines[k].strip()), len(lines))
            first, *rest = (line.strip() for line in lines[at + 2 : end])
            field = "returns" if title == "Returns" else title
            returned[name] = [f":{field}: {first}", *(f"    {line}" for line in rest)]
            del lines[at:end]
            return


def _put_returns(_app: Sphinx, _what: str, name: str, _obj: Any, _options: Any, lines: list[str]) -> None:
    """Put the paragraph back as a field between the parameters and the exceptions; shorten the types of attributes."""
    lines[:] = [ARRAY.sub(r"NDArray[\1]", line) for line in lines]
    lines[:] = [MODULE.sub("", line) if line.strip().startswith(":type:") else line for line in lines]
    if field := returned.pop(name, None):
        at = next((k for k, line in enumerate(lines) if line.startswith(":raises")), None)
        if at is not None:
            lines[at:at] = field
        else:
            has_fields = any(line.startswith(":param") for line in lines)
            while lines and not lines[-1].strip():
                lines.pop()
            lines += [*([] if has_fields else [""]), *field, ""]


def _readable_defaults(
    _app: Sphinx, _what: str, _name: str, _obj: Any, _options: Any, signature: str | None, returns: str | None
) -> Any:
    """Write defaults that are no Python, such as `<factory>`, as an ellipsis; leave out the signatures of protocols."""
    if signature == "(*args, **kwargs)":
        return "", returns
    return (re.sub(r"<[\w ]+>", "...", signature), returns) if signature and "<" in signature else None


def _add_download(app: Sphinx, doctree: nodes.document) -> None:
    """Add a link to the file below the title of a notebook."""
    name = app.env.docname
    if name.startswith("notebooks/"):
        link = addnodes.download_reference(
            "", "", nodes.inline("", "Download this notebook"), reftarget=f"/{name}.ipynb", refdoc=name
        )
        title = next(doctree.findall(nodes.title))
        title.parent.insert(title.parent.index(title) + 1, nodes.paragraph("", "", link))


def setup(app: Sphinx) -> None:
    """Connect the changes to docstrings and signatures."""
    # Napoleon has 500
    app.connect("autodoc-process-docstring", _take_returns, priority=400)
    app.connect("autodoc-process-docstring", _put_returns, priority=600)
    app.connect("autodoc-process-signature", _readable_defaults)
    # Sphinx collects downloads at 500
    app.connect("doctree-read", _add_download, priority=400)
    app.connect("doctree-read", _short_types)
