"""What an experiment leaves: pictures, tables, data, and each claim of the paper beside what was measured."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from heliograph.sweeps.executors import Result, Work, each

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Verdict = Literal["holds", "differs", "shown"]
"""A claim holds or not in what was measured; "shown" where the paper claims nothing that can be counted."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A claim and what was measured.

    Attributes
    ----------
    claim
        What the paper says, or what was asked.
    ours
        What was measured, with counts and interval.
    verdict
        See `Verdict`.
    why
        Where they differ: why.
    """

    claim: str
    ours: str
    verdict: Verdict
    why: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """A table: its heading, the heads of its columns, its rows."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]


@dataclass(frozen=True, slots=True)
class Chapter:
    """Results of an experiment.

    Attributes
    ----------
    key, title
        Name on the command line, such as "fig13", and heading.
    text
        What was done, for a reader of the report.
    findings
        Claims and measurements.
    pictures
        Plots, each with a caption.
    tables
        Tables.
    data
        Numbers behind pictures and tables: plain values, for JSON.
    """

    key: str
    title: str
    text: str
    findings: Sequence[Finding] = ()
    pictures: Sequence[tuple["Figure", str]] = ()
    tables: Sequence[Table] = ()
    data: Mapping[str, Any] = field(default_factory=dict)


def quiet(title: str, done: float, /) -> None:
    """Report no progress."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Context:
    """What an experiment may use.

    Attributes
    ----------
    quick
        Whether to be done soon, with wide intervals.
    seed
        Of all randomness.
    clips
        Real footage by name; empty: a drawn scene takes its place.
    imu
        Recorded motion of a car, or None: a road takes its place.
    workers
        Processes to use.
    progress
        Called with a title and the share done, 0 to 1.
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
        """Results of a job for each of some works by the workers; see `executors.each`.

        Parameters
        ----------
        title
            For the progress.
        job, works
            What is done, and with what.
        span
            Shares of the experiment done before and after.
        """
        start, end = span
        return each(self.workers, job, works, lambda share: self.progress(title, start + (end - start) * share))
