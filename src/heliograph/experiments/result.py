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
    """A claim and the measurement beside it.

    Attributes
    ----------
    claim
        The paper's claim, or a question of our own.
    ours
        The measurement, with counts and interval.
    verdict
        Whether the claim "holds" or "differs", or is only "shown"; see `Verdict`.
    why
        The reason where they differ; empty where there is none to give.
    """

    claim: str
    ours: str
    verdict: Verdict
    why: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """A table.

    Attributes
    ----------
    title
        Heading above the table.
    head
        Heads of the columns.
    rows
        Cells, row by row; each row has a cell for each column.
    """

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]

    def markdown(self) -> str:
        """The table in Markdown, without its heading."""
        lines = [self.head, ["---"] * len(self.head), *self.rows]
        return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


@dataclass(frozen=True, slots=True)
class ExperimentResult:
    """The result of an experiment.

    Attributes
    ----------
    key, title
        Name on the command line, such as "fig13", and heading.
    text
        Describes the experiment for a reader of the report.
    findings
        Claims, each with the measurement beside it.
    pictures
        Plots, each with a caption.
    tables
        Tables of the measurements, each with its heading.
    data
        The numbers of pictures and tables as plain values, for JSON.
    drawn
        PNG files of plots that an earlier run drew, each with a caption.
    """

    key: str
    title: str
    text: str
    findings: Sequence[Finding] = ()
    pictures: Sequence[tuple["Figure", str]] = ()
    tables: Sequence[Table] = ()
    data: Mapping[str, Any] = field(default_factory=dict)
    drawn: Sequence[tuple[bytes, str]] = ()


def quiet(title: str, done: float, /) -> None:
    """Report no progress.

    Parameters
    ----------
    title, done
        Title of what is being done, and the fraction done, 0 to 1. Both are ignored.
    """


@dataclass(frozen=True, kw_only=True, slots=True)
class Context:
    """Effort, seed, recordings and workers of an experiment.

    Attributes
    ----------
    quick
        Few trials: minutes in place of tens of minutes, with wide intervals.
    seed
        Seed of all randomness, 0 or more.
    clips
        Files of real footage by name; empty: a drawn scene takes their place.
    imu
        File of recorded car motion; None: a road takes its place.
    workers
        Processes to use, 1 or more.
    progress
        Called with a title and the fraction done, 0 to 1.
    """

    quick: bool = True
    seed: int = 0
    clips: Mapping[str, Path] = field(default_factory=dict)
    imu: Path | None = None
    workers: int = 1
    progress: Callable[[str, float], None] = quiet

    def each(
        self,
        title: str,
        job: Callable[[Work], Result],
        works: Iterable[Work],
        span: tuple[float, float] = (0.0, 1.0),
    ) -> list[Result]:
        """Results of a job for each of some works, computed by the workers; see `executors.each`.

        Parameters
        ----------
        title
            What is being done, as the progress names it.
        job
            A function of a module, so that a worker process can find it.
        works
            Arguments of the job, one for each call.
        span
            Fractions of the experiment done before and after, each 0 to 1.

        Raises
        ------
        HeliographError
            A worker process was lost.
        """
        start, end = span
        return each(self.workers, job, works, lambda done: self.progress(title, start + (end - start) * done))
