"""Results of experiments, with claims and verdicts, and their report in a single HTML file."""

import base64
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from heliograph.base.files import write_whole
from heliograph.sweeps.executors import Result, Work, each

if TYPE_CHECKING:
    from matplotlib.figure import Figure


Verdict = Literal["holds", "differs", "shown"]
"""A claim "holds" or "differs"; "shown": nothing was claimed that can be counted, or too little was counted."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A claim and the measurement beside it."""

    # The paper's claim, or a question of our own
    claim: str
    # The measurement, with counts and interval
    ours: str
    # Whether the claim "holds" or "differs", or is only "shown"; see `Verdict`
    verdict: Verdict
    # The reason where they differ; empty where there is none to give
    why: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """A table."""

    # Heading above the table
    title: str
    # Heads of the columns
    head: Sequence[str]
    # Cells, row by row; each row has a cell for each column
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """The table in Markdown, without its heading."""
        lines = [self.head, ["---"] * len(self.head), *self.rows]
        return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


@dataclass(frozen=True, slots=True)
class ExperimentResult:
    """The result of an experiment."""

    # key, title: name on the command line, such as "fig13", and heading
    key: str
    title: str
    # Describes the experiment for a reader of the report
    text: str
    # Claims, each with the measurement beside it
    findings: Sequence[Finding] = ()
    # Plots, each with a caption
    pictures: Sequence[tuple["Figure", str]] = ()
    # Tables of the measurements, each with its heading
    tables: Sequence[Table] = ()
    # The numbers of pictures and tables as plain values, for JSON
    data: Mapping[str, Any] = field(default_factory=dict)
    # PNG files of plots that an earlier run drew, each with a caption
    drawn: Sequence[tuple[bytes, str]] = ()


def quiet(title: str, done: float, /) -> None:
    """Report no progress."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Context:
    """Effort, seed, recordings and workers of an experiment."""

    # Few trials: minutes in place of tens of minutes, with wide intervals
    quick: bool = True
    # Seed of all randomness, 0 or more
    seed: int = 0
    # Files of real footage by name; empty: a drawn scene takes their place
    clips: Mapping[str, Path] = field(default_factory=dict)
    # File of recorded car motion; None: a road takes its place
    imu: Path | None = None
    # Processes to use, 1 or more
    workers: int = 1
    # Called with a title and the fraction done, 0 to 1
    progress: Callable[[str, float], None] = quiet

    def each(
        self,
        title: str,
        job: Callable[[Work], Result],
        works: Iterable[Work],
        span: tuple[float, float] = (0.0, 1.0),
    ) -> list[Result]:
        """Results of a job for each of some works, computed by the workers; see `executors.each`."""
        start, end = span
        return each(self.workers, job, works, lambda done: self.progress(title, start + (end - start) * done))


STYLE = """
body { font: 16px/1.5 system-ui, sans-serif; color: #1d2126; max-width: 62rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.8rem; margin-bottom: .3rem } h2 { font-size: 1.2rem; margin-top: 2.2rem }
figure { margin: 1rem 0 } img { max-width: 100%; height: auto } figcaption, .note { color: #5a636e; font-size: .92rem }
table { border-collapse: collapse; margin: 1rem 0; font-size: .88rem } .wide { overflow-x: auto }
th, td { padding: .3rem .7rem; text-align: right }
th, td { white-space: nowrap; border-bottom: 1px solid #e3e6ea } th { border-bottom: 2px solid #c9ced6 }
.prose td, .prose th { white-space: normal; text-align: left; vertical-align: top }
nav { columns: 18rem; margin: 1.2rem 0; font-size: .95rem } nav a { display: block; color: #1b6ca8 }
.badge { border-radius: 1rem; padding: .1rem .6rem; font-size: .85rem; white-space: nowrap }
.badge { color: #fff; background: #5a636e }
.good { background: #2f7d3b } .bad { background: #b3261e } .count { margin-right: .5rem }
th:first-child, td:first-child { text-align: left } pre { background: #f4f5f7; padding: .7rem; white-space: pre-wrap }
"""

BADGES = {"holds": "badge good", "differs": "badge bad", "shown": "badge"}
"""Classes of the style for the words that are set in colour."""


class Report:
    """Collects parts of a page."""

    def __init__(self, title: str):
        self._title = title
        self._parts: list[str] = []
        self._headings: list[str] = []

    def heading(self, text: str) -> None:
        """Begin a section."""
        self._headings.append(text)
        self._parts.append(f"<h2 id=part-{len(self._headings)}>{escape(text)}</h2>")

    def text(self, text: str, note: bool = False) -> None:
        """Add a paragraph."""
        self._parts.append(f"<p{' class=note' if note else ''}>{escape(text)}</p>")

    def verdict(self, verdict: str, text: str) -> None:
        """Add a paragraph that begins with a verdict in colour."""
        self._parts.append(f"<p>{_badge(verdict)} {escape(text)}</p>")

    def badges(self, shown: Iterable[tuple[str, str]]) -> None:
        """Add a line of words in colour."""
        parts = (f"<span class=count>{_badge(word, text)}</span>" for word, text in shown)
        self._parts.append(f"<p>{' '.join(parts)}</p>")

    def code(self, text: str) -> None:
        """Add text in a fixed-width font, with its line breaks."""
        self._parts.append(f"<pre>{escape(text)}</pre>")

    def figure(self, figure: "Figure", caption: str) -> None:
        """Add a plot."""
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=130, bbox_inches="tight")
        self.picture(out.getvalue(), caption)

    def picture(self, png: bytes, caption: str) -> None:
        """Add a picture."""
        kind = "webp" if png.startswith(b"RIFF") else "png"
        data = base64.b64encode(png).decode()
        image = f'<img alt="{escape(caption)}" src="data:image/{kind};base64,{data}">'
        self._parts.append(f"<figure>{image}<figcaption>{escape(caption)}</figcaption></figure>")

    def table(self, head: Sequence[str], rows: Sequence[Sequence[str]], prose: bool = False) -> None:
        """Add a table."""
        top = "".join(f"<th>{escape(cell)}</th>" for cell in head)
        body = "".join("<tr>" + "".join(f"<td>{_cell(cell)}</td>" for cell in row) + "</tr>" for row in rows)
        kind = " class=prose" if prose else ""
        self._parts.append(f"<div class=wide><table{kind}><tr>{top}</tr>{body}</table></div>")

    def write(self, path: Path) -> None:
        """Write the page, whole or not at all."""
        head = (
            f"<meta charset=utf-8><meta name=viewport content='width=device-width'><title>{escape(self._title)}</title>"
        )
        page = f"<!doctype html><html lang=en><head>{head}<style>{STYLE}</style></head><body>"
        title = f"<h1>{escape(self._title)}</h1>\n{self._contents()}\n"
        write_whole(
            path, (page + title + "\n".join(self._parts) + "</body></html>\n").encode(errors="backslashreplace")
        )

    def _contents(self) -> str:
        """A list of the sections, where there are several."""
        # Fewest sections of a page that get a list of contents. Chosen
        if len(self._headings) < 3:
            return ""
        links = (f"<a href=#part-{k}>{escape(text)}</a>" for k, text in enumerate(self._headings, 1))
        return f"<nav aria-label=Contents>{''.join(links)}</nav>"


def _badge(word: str, text: str = "") -> str:
    return f'<span class="{BADGES.get(word, "badge")}">{escape(text or word)}</span>'


def _cell(text: str) -> str:
    return _badge(text) if text in BADGES else escape(text)
