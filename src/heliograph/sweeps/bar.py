"""The progress of a sweep on a terminal."""

import contextlib
import sys
from collections.abc import Iterator, Sequence

from heliograph.sweeps.runner import PointProgress, silent
from heliograph.sweeps.tally import PointTally

SCALE = 1000
"""Parts of a point in the progress bar."""

SPEED_PERIOD_S = 3600.0
"""Time in s over which the speed is averaged that the time left is estimated from."""


def on_a_terminal() -> bool:
    """Whether somebody sees what is written to standard error."""
    return sys.stderr is not None and sys.stderr.isatty()


@contextlib.contextmanager
def bar(points: int, shown: bool | None = None) -> Iterator[PointProgress]:
    """A bar on standard error, with the points done and the time left."""
    if not (on_a_terminal() if shown is None else shown):
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    # a block may take longer than Rich's half a minute, without which it has no speed
    screen = Console(stderr=True, force_terminal=True)
    period = SPEED_PERIOD_S
    with Progress(*columns, console=screen, transient=True, speed_estimate_period=period) as progress:
        task = progress.add_task("sweeping", total=SCALE * points)

        def show(tallies: Sequence[PointTally]) -> None:
            done = f"{sum(t.done for t in tallies)} of {points} points"
            progress.update(task, description=done, completed=round(SCALE * sum(t.fraction for t in tallies)))

        yield show
