"""Results of experiments with claims and verdicts, and the HTML page that reports them."""

import base64
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import jinja2

from heliograph.base.files import write_whole
from heliograph.sweeps.executors import Result, Work, each

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from heliograph.measure.statistics import Count


Verdict = Literal["holds", "differs", "shown"]
"""Verdict on a claim; "shown": the claim cannot be counted, or too little was counted."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Claim and measurement."""

    # Claim of the paper, or a further question
    claim: str
    # Measured counts with intervals
    ours: str
    verdict: Verdict
    # Reason of a difference; empty if unknown
    why: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """Table with a title, column heads and rows of cells."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    @classmethod
    def of(cls, title: str, items: Iterable[Any], columns: Mapping[str, Callable[[Any], str]]) -> "Table":
        """Make a table with a row for each item, from the text of an item by column head."""
        return cls(title, list(columns), [[text(item) for text in columns.values()] for item in items])

    def markdown(self) -> str:
        """Head and rows in Markdown."""
        lines = [self.head, ["---"] * len(self.head), *self.rows]
        return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


@dataclass(frozen=True, kw_only=True, slots=True)
class ExperimentResult:
    """Result of an experiment."""

    # Name on the command line, such as "fig13", and title; set by `reproduce`
    key: str = ""
    title: str = ""
    # Effort; `reproduce` adds the description of the experiment, in paragraphs
    text: str = ""
    findings: Sequence[Finding]
    # Figures with captions
    pictures: Sequence[tuple["Figure", str]] = ()
    tables: Sequence[Table] = ()
    # Numbers of figures and tables as plain values for JSON
    data: Mapping[str, Any] = field(default_factory=dict)
    # SVG files of the figures with captions, as in the report
    drawn: Sequence[tuple[bytes, str]] = ()


@dataclass(frozen=True, kw_only=True, slots=True)
class Context:
    """Effort, seed, recordings and workers of an experiment."""

    # Few trials: minutes instead of tens of minutes, with wide intervals
    quick: bool = True
    seed: int = 0
    # Files of real footage by name; empty: drawn scenes
    clips: Mapping[str, Path] = field(default_factory=dict)
    # File of recorded car motion; None: simulated road
    imu: Path | None = None
    # Number of processes
    workers: int = 1
    # Called with a title and the completed fraction
    progress: Callable[[str, float], None] = lambda *_: None

    def each(
        self, title: str, job: Callable[[Work], Result], works: Iterable[Work], span: tuple[float, float] = (0.0, 1.0)
    ) -> list[Result]:
        """Run a job for each work item in the workers; see `executors.each`."""
        start, end = span
        return each(self.workers, job, works, lambda done: self.progress(title, start + (end - start) * done))


def verdict_of(holds: bool | None) -> Verdict:
    """Verdict of a test; None: undecided."""
    return "shown" if holds is None else "holds" if holds else "differs"


def count_text(count: "Count") -> str:
    """Errors of trials as text."""
    return f"{count.errors} of {count.trials}"


def interval_text(count: "Count", form: str = ".2g", separator: str = " to ") -> str:
    """95 % interval of a rate as text."""
    return separator.join(format(end, form) for end in count.interval())


_ENVIRONMENT = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent), autoescape=True, trim_blocks=True, lstrip_blocks=True
)


class Report:
    """Page of headings, paragraphs, pictures and tables in a single HTML file."""

    def __init__(self, title: str):
        self._title = title
        self._parts: list[dict[str, Any]] = []

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._parts.append({"kind": "heading", "text": text})

    def text(self, text: str, note: bool = False) -> None:
        """Add a paragraph."""
        self._parts.append({"kind": "text", "text": text, "note": note})

    def link(self, address: str, text: str) -> None:
        """Add a link to a page in the same folder."""
        self._parts.append({"kind": "link", "address": address, "text": text})

    def verdict(self, verdict: str, text: str) -> None:
        """Add a paragraph that begins with a coloured verdict."""
        self._parts.append({"kind": "verdict", "verdict": verdict, "text": text})

    def badges(self, badges: Iterable[tuple[str, str]]) -> None:
        """Add a line of texts, each in the colour of a verdict."""
        self._parts.append({"kind": "badges", "badges": list(badges)})

    def code(self, text: str) -> None:
        """Add preformatted text."""
        self._parts.append({"kind": "code", "text": text})

    def figure(self, figure: "Figure", caption: str) -> None:
        """Add a plot."""
        from heliograph.experiments.plots import figure_svg  # Matplotlib is slow to import

        self.picture(figure_svg(figure), caption)

    def picture(self, image: bytes, caption: str) -> None:
        """Add an SVG, PNG or WebP file."""
        kind = {b"RIFF": "webp", b"\x89PNG": "png"}.get(image[:4], "svg+xml")
        data = base64.b64encode(image).decode()
        self._parts.append({"kind": "picture", "format": kind, "data": data, "caption": caption})

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], prose: bool = False, title: str = "") -> None:
        """Add a table, with wrapped cells if they are prose, folded below the title if it has one."""
        self._parts.append({"kind": "table", "head": head, "rows": rows, "prose": prose, "title": title})

    def write(self, path: Path) -> None:
        """Write the page."""
        page = _ENVIRONMENT.get_template("report.html.j2").render(title=self._title, parts=self._parts)
        write_whole(path, page.encode(errors="backslashreplace"))
