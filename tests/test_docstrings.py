"""Public functions, methods and classes of the packages in HELD describe parameters, shapes of arrays, and errors."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1] / "src" / "heliograph"

HELD = (
    "base",
    "signal",
    "transmit",
    "channel",
    "media",
    "receive",
    "panel",
    "road",
    "link",
    "measure",
    "sweeps",
    "datasets",
    "experiments",
    "probe",
)
"""Packages held to the rules: all but the command line, whose parameters its help describes."""

ERRORS = {"HeliographError", "SettingsError", "MediaError", "ValueError"}
"""Errors that a body raises on purpose."""

FEWEST_WORDS = 4
"""Words of which a description has at least so many: "The array's." tells neither what it is nor its unit."""

ARRAY = re.compile(r"(NDArray\[.*\]|Floats|Pixels)( \| .*)?")
"""An annotation of one array, not of several in a list or by name."""

SHAPED = re.compile(r"\(\.\.\.\)|\([^()]*,[^()]*\)|\b(arrays?|shapes?|scalars?)\b", re.I)
"""What tells an array's shape: "(rows, columns)", "(n,)", "(...)", or words that say whose it is."""

PUBLIC_MAGIC = ("__call__",)
"""Magic methods that are called by hand, and so described."""

Function = ast.FunctionDef | ast.AsyncFunctionDef
Definition = Function | ast.ClassDef
Found = tuple[str, Definition]


def is_public(name: str) -> bool:
    return not name.startswith("_") or name in PUBLIC_MAGIC


def definitions(body: list[ast.stmt], prefix: str) -> Iterator[Found]:
    """Public functions, classes and their public methods, by dotted name."""
    for node in body:
        if isinstance(node, Definition) and is_public(node.name):
            name = f"{prefix}.{node.name}"
            yield name, node
            if isinstance(node, ast.ClassDef):
                yield from definitions(node.body, name)


def found(package: str) -> list[Found]:
    paths = sorted((ROOT / package).rglob("*.py"))
    return [
        item
        for path in paths
        for item in definitions(
            ast.parse(path.read_text(encoding="utf-8")).body, ".".join(path.relative_to(ROOT).with_suffix("").parts)
        )
    ]


def section(doc: str, title: str) -> dict[str, str]:
    """Items of a NumPy section: the text of each `name`, `name : type` or `a, b` line, by that line."""
    match = re.search(rf"^{title}\n-{{{len(title)}}}\n(.*?)(?=\n\n?[^\n]+\n-{{3,}}\n|\Z)", doc, re.M | re.S)
    items: dict[str, list[str]] = {}
    for line in match[1].splitlines() if match else []:
        if line and not line[0].isspace():
            items[line] = []
        elif items:
            items[next(reversed(items))].append(line.strip())
    return {name: " ".join(lines).strip() for name, lines in items.items()}


def listed(doc: str, title: str) -> set[str]:
    """Names of a section's items that have a text."""
    items = section(doc, title)
    return {name.strip() for line, text in items.items() if text for name in line.partition(" : ")[0].split(",")}


def too_short(doc: str, title: str) -> list[str]:
    """Items of a section whose text says hardly more than their names."""
    return [name for name, text in section(doc, title).items() if 0 < len(text.split()) < FEWEST_WORDS]


def parameters(node: Function, method: bool) -> list[str]:
    """Names of the parameters, but for self or cls, *args and **kwargs."""
    names = [a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    static = any(isinstance(d, ast.Name) and d.id == "staticmethod" for d in node.decorator_list)
    return names[1:] if method and not static else names


def arrays(node: Definition) -> set[str]:
    """Parameters and fields that are arrays by their annotation."""
    annotated: dict[str, ast.expr | None] = {}
    for one in constructors(node) if isinstance(node, ast.ClassDef) else [node]:
        annotated |= {a.arg: a.annotation for a in (*one.args.posonlyargs, *one.args.args, *one.args.kwonlyargs)}
    if isinstance(node, ast.ClassDef):
        annotated |= {
            n.target.id: n.annotation
            for n in node.body
            if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)
        }
    return {name for name, said in annotated.items() if said is not None and ARRAY.fullmatch(ast.unparse(said))}


def shapeless(doc: str, node: Definition) -> list[str]:
    """Arrays of which neither their item nor what comes before all items tells the shape.

    An item that names another place, as `render`, has its shape there.
    """
    head = re.split(r"\n[^\n]+\n-{3,}\n", doc)[0]
    if SHAPED.search(head):
        return []
    items = [item for title in ("Parameters", "Attributes") for item in section(doc, title).items()]
    names = [
        name.strip()
        for line, text in items
        if not SHAPED.search(f"{line} {text}") and not re.search(r"(?<!`)`\w", text)
        for name in line.partition(" : ")[0].split(",")
    ]
    return [name for name in names if name in arrays(node)]


def is_dataclass(node: ast.ClassDef) -> bool:
    return any(re.match(r"(dataclass|checked)\b", ast.unparse(d)) for d in node.decorator_list) or any(
        ast.unparse(base) == "NamedTuple" for base in node.bases
    )


def fields(node: ast.ClassDef) -> list[str]:
    """Public fields of a dataclass."""
    targets = [n.target for n in node.body if isinstance(n, ast.AnnAssign)]
    return [t.id for t in targets if isinstance(t, ast.Name) and is_public(t.id)]


def raised(node: Function) -> set[str]:
    """Errors of `ERRORS` that a function's own body raises."""
    names: set[str] = set()
    waiting: list[ast.AST] = list(node.body)
    while waiting:
        one = waiting.pop()
        if isinstance(one, Definition | ast.Lambda):
            continue
        if isinstance(one, ast.Raise) and isinstance(one.exc, ast.Call) and isinstance(one.exc.func, ast.Name):
            names |= {one.exc.func.id} & ERRORS
        waiting += ast.iter_child_nodes(one)
    return names


def constructors(node: ast.ClassDef) -> list[Function]:
    return [n for n in node.body if isinstance(n, Function) and n.name in ("__init__", "__post_init__")]


def protocol_doc(name: str, doc: str, items: dict[str, Definition]) -> str:
    """Docstring of the protocol's method that a method refers to by "see `Protocol`"."""
    told = re.search(r"see `(\w+)`\.", doc)
    ending = f".{told[1]}.{name.rpartition('.')[2]}" if told else None
    return next((ast.get_docstring(node) or "" for key, node in items.items() if ending and key.endswith(ending)), "")


def problems(name: str, node: Definition, items: dict[str, Definition]) -> Iterator[str]:
    doc = ast.get_docstring(node)
    if not doc:
        yield f"{name}: no docstring"
        return
    if isinstance(node, ast.ClassDef):
        wanted = fields(node) if is_dataclass(node) else []
        wanted += [p for make in constructors(node) for p in parameters(make, True)]
        had, errors = (
            listed(doc, "Parameters") | listed(doc, "Attributes"),
            set[str]().union(*map(raised, constructors(node))),
        )
    else:
        wanted = parameters(node, isinstance(items.get(name.rpartition(".")[0]), ast.ClassDef))
        had, errors = listed(doc, "Parameters") | listed(protocol_doc(name, doc, items), "Parameters"), raised(node)
    if missing := [p for p in wanted if p not in had]:
        yield f"{name}: not described: {', '.join(missing)}"
    if short := [item for title in ("Parameters", "Attributes") for item in too_short(doc, title)]:
        yield f"{name}: says too little: {', '.join(short)}"
    if unshaped := shapeless(doc, node):
        yield f"{name}: shape not told: {', '.join(unshaped)}"
    if unsaid := errors - listed(doc, "Raises"):
        yield f"{name}: not under Raises: {', '.join(sorted(unsaid))}"


def all_problems(items: list[Found]) -> list[str]:
    return [text for name, node in items for text in problems(name, node, dict(items))]


@pytest.mark.parametrize("package", HELD)
@pytest.mark.slow
def test_everything_public_is_described(package: str) -> None:
    items = found(package)
    assert items
    assert all_problems(items) == []


@pytest.mark.parametrize("package", HELD)
def test_settings_describe_each_attribute_by_itself(package: str) -> None:
    settings = [
        (name, node)
        for name, node in found(package)
        if isinstance(node, ast.ClassDef) and any("config=CONFIG" in ast.unparse(d) for d in node.decorator_list)
    ]
    for name, node in settings:
        assert list(section(ast.get_docstring(node) or "", "Attributes")) == fields(node), name


BAD = '''
def bare(x): pass

def one(x):
    """One parameter is described, too.

    Parameters
    ----------
    x
        Length of x in m.
    """

def two(x, y, *rest, **more):
    """Lack y.

    Parameters
    ----------
    x
        The first of both numbers.

    Returns
    -------
    y
        Not a parameter.
    """

def pair(x, y):
    """List both.

    Parameters
    ----------
    x, y
        Both of the numbers.
    """
    def inner():
        raise ValueError("of the inner one")
    raise RuntimeError("not on purpose")

def short(x):
    """Say too little.

    Parameters
    ----------
    x
        The array's.
    """

def image(a: Floats, b: Floats, c: NDArray[np.uint8] | None, d: list[Floats], e: Floats, f: float):
    """Tell how large some are.

    Parameters
    ----------
    a
        (rows, columns) gray levels.
    b
        Gray levels of the pixels.
    c : ndarray of uint8, shape (..., K)
        Bits of the blocks.
    d
        Gray levels of several pixels.
    e
        Gray levels, as in `frame`.
    f
        Gray level (the lowest) of all.
    """

class Pose:
    """Places at any times; all arrays have one shape.

    Attributes
    ----------
    x_m
        Column of the centre in m.
    """

    x_m: Floats

class Seen:
    """Places seen by the camera, with a parenthesis (of prose).

    Attributes
    ----------
    x_m
        Column of the centre in m.
    """

    x_m: Floats

def wrong():
    """Raise without saying so."""
    if now:
        raise ValueError("x")

def right():
    """Raise.

    Raises
    ------
    ValueError
        It is now.
    """
    if now:
        raise ValueError("x")

class Made:
    """Lack b.

    Parameters
    ----------
    a
        The first of both numbers.
    """

    def __init__(self, a, b):
        raise SettingsError("never made")

    def method(self, x):
        """One parameter."""

    def none(self):
        """No parameter."""

    @staticmethod
    def static(x, y):
        """Two parameters."""

    def _private(self, x, y): pass

class Agreed(Protocol):
    """Describe a method."""

    def read(self, x, y):
        """Read.

        Parameters
        ----------
        x, y
            Both of the numbers.
        """

class Keeping:
    """Keep to a protocol."""

    def read(self, x, y):
        """Read fast; see `Agreed`."""

    def write(self, x, y):
        """Write; see `Agreed`."""

@dataclass(frozen=True)
class Data:
    """Lack count.

    Attributes
    ----------
    size : int
        Size of it in px.
    count
    """

    size: int
    count: int = 0
    _own: int = 0
'''


def test_each_fault_is_found() -> None:
    assert all_problems(list(definitions(ast.parse(BAD).body, "m"))) == [
        "m.bare: no docstring",
        "m.two: not described: y",
        "m.short: says too little: x",
        "m.image: shape not told: b",
        "m.Seen: shape not told: x_m",
        "m.wrong: not under Raises: ValueError",
        "m.Made: not described: b",
        "m.Made: not under Raises: SettingsError",
        "m.Made.method: not described: x",
        "m.Made.static: not described: x, y",
        "m.Keeping.write: not described: x, y",
        "m.Data: not described: count",
    ]
