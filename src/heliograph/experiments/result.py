"""The result of an experiment: pictures, tables, data, and each claim of the paper beside the measurement."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

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
