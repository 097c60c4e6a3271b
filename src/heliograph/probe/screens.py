"""Why a screen that is filmed is not read: out of focus, too small, too bright, or nothing that changes."""

from collections.abc import Sequence
from contextlib import suppress

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.probe.causes import Cause
from heliograph.probe.reading import Asked
from heliograph.receive.screen.receiver import ScreenReceiver, Sight

GLARE = 0.1
"""Part of an array at full scale from which it is too bright. Of random data a sixteenth of the cells show white."""

CELL_PX = 5.0
"""Px a cell below which a place is not kept while a hand sways: see `docs/how-to/film-a-screen.md`."""

SHARP = 0.35
"""Blur in cells from which the low layer goes. Chosen: at 0.4 cells a cell gives a quarter of its light to its
neighbours."""

POOR_FIT = 0.3
"""Misfit from which cells do not explain the picture: in focus it is 0.03 to 0.15."""


def screen_causes(frames: Sequence[Frame], asked: Asked) -> tuple[Cause, ...]:
    """Tell why a screen is not read.

    Parameters
    ----------
    frames
        Frames in the order of time, of the film's liveliest stretch.
    asked
        What it was to be read with; its receiver is "screen".
    """
    receiver = ScreenReceiver(asked.signal, asked.settings, lambda _: None)
    sights = list[Sight]()
    for frame in frames:
        with suppress(HeliographError):
            for _ in receiver.push(frame):
                pass
        if receiver.sight is not None:
            sights.append(receiver.sight)
    if not sights:
        return (_not_seen(asked),)
    sight = sights[-1]
    side = sight.cell_px * asked.signal.side
    found = []
    saturated = sum(one.saturated for one in sights) / len(sights)
    if saturated > GLARE:
        found.append(
            Cause(
                "saturated",
                f"{100 * saturated:.0f} % of the array is at full scale, so that bright levels look alike",
                ("lower the display's brightness or the camera's exposure, and keep reflections off the screen",),
            )
        )
    if sight.cell_px < CELL_PX:
        found.append(
            Cause(
                "too small",
                f"a cell has {sight.cell_px:.1f} px, the array {side:.0f} px; {CELL_PX:g} px a cell are needed",
                (
                    "go nearer, film with more pixels, or show fewer cells: --set signal.side=8 at both ends",
                    f"signal.side is {asked.signal.side}: see that the screen shows as many cells in a row",
                ),
            )
        )
    if sight.blur_px > SHARP * sight.cell_px or sight.misfit > POOR_FIT:
        found.append(
            Cause(
                "out of focus",
                f"cells of {sight.cell_px:.1f} px are blurred by {sight.blur_px:.1f} px or more, and explain all but "
                f"{100 * sight.misfit:.0f} % of the picture",
                (
                    "focus on the screen and lock the focus; hold the camera still",
                    "see that signal.side is the screen's",
                ),
            )
        )
    if not found:
        why = (
            "its patterns follow a clock, but no header is read"
            if sight.clocked
            else "its patterns follow no known rate"
        )
        advice = (
            "film at least two packets; see that no refresh of the display is skipped",
            "name the rate: --set signal.pattern_period_s=SECONDS, and --fps RATE where a film in slow motion hides it",
        )
        found.append(Cause("unread", f"an array of {side:.0f} px is followed; {why}", advice))
    return tuple(found)


def _not_seen(asked: Asked) -> Cause:
    return Cause(
        "no header",
        f"nothing changes as an array of {asked.signal.side} x {asked.signal.side} cells does",
        (
            "hold all of the array in the picture, with its dark margin; see that signal.side is the screen's",
            "take the display out of reflections, and see that it is not at full scale in the picture",
        ),
    )
