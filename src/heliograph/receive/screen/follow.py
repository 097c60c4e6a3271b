"""An array of a screen followed from frame to frame: what each frame shows of its cells."""

from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.screen.grid import Look, Place, Seen, inside

LARGEST_MISFIT = 0.6
"""Largest part of a picture that cells may leave unexplained, by its rms. Chosen: 0.06 to 0.3 is seen of an array in
its place, 0.6 to 0.9 of one that is half a cell off."""

FORGOTTEN = 0.5
"""Part of a motion that is expected to go on from frame to frame. Chosen: sway goes on, tremor turns back."""


STRANGE = 0.3
"""Rms by which a side of the ring around an array may differ from what it usually shows, by the array's light. Cells of
the array there, a cell off, differ by 0.5 to 1."""

DARK = 0.15
"""Light of an array by that of the brightest frames below which it tells nothing. Chosen: 2 % of the weight of
others."""

GROWTH = 1.03
"""Factor by which the usual misfit follows that of a frame. Chosen: in 30 frames it has doubled."""

USUAL = 0.05
"""Weight of a frame in what the ring usually shows. Chosen: the light beside a screen changes in seconds."""

SHIFTS = tuple((x, y) for x in (0, -0.6, 0.6, -1.2, 1.2) for y in (0, -0.6, 0.6, -1.2, 1.2))
"""Cells, right and down, by which a place may have slipped: the fit finds one that is half a cell off."""

POOR = 1.8
"""Misfit by the usual one from which a frame is tried from other places. Chosen: a frame of a header or one that is
smeared has up to 1.5."""


@dataclass(frozen=True)
class Sample:
    """What a frame shows of an array."""

    # Number of the frame
    index: int
    # Start of its first row's exposure by the camera's clock
    time_s: float
    # (n, n, 2) x and y of each cell in px
    at: Floats
    # The cells' light, and their place
    seen: Seen


class Follower:
    """Follows an array."""

    def __init__(self, look: Look, place: Place, firm: bool = True):
        self._look, self.place, self._firm = look, place, firm
        n = look.side
        self._middles = np.stack(np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5), axis=-1)
        self._motion = np.zeros(2)
        self._ring: Floats | None = None
        self._usual = LARGEST_MISFIT / POOR
        self._sure = place
        self._bright = 0.0
        self.lost_since: float | None = None

    @property
    def blur_px(self) -> float:
        """Standard deviation of the blur in px by which cells are found."""
        return self._look.blur_px

    def take(self, frame: Frame, steps: int = 4) -> Sample | None:
        """Find the array in the next frame; None where it is not seen."""
        expected = self.place.moved(FORGOTTEN * self._motion)
        seen = self._seen(frame, expected, steps)
        if seen is not None and float(seen.light.mean()) < DARK * self._bright:
            return None  # the backlight was off
        if self._firm and (seen is None or self._doubt(seen) > 1) and self._look.budget.lasts:
            seen = self._slipped(frame, expected, steps, seen)
        if seen is None:
            self._motion = np.zeros(2)
            if self.lost_since is None:
                self.lost_since = frame.time_s
            return None
        self.lost_since = None
        middle = np.array([self._look.side / 2] * 2)
        self._motion = seen.place.at(middle) - self.place.at(middle)
        self.place = seen.place
        self._learn(seen)
        return Sample(frame.index, frame.time_s, self.place.at(self._middles), seen)

    def _slipped(self, frame: Frame, place: Place, steps: int, seen: Seen | None) -> Seen | None:
        """The best that is seen about a place, of the shape that the array had when it was last seen well."""
        if self._ring is None:
            return seen
        middle = np.array([self._look.side / 2] * 2)
        shaped = self._sure.moved(place.at(middle) - self._sure.at(middle))
        tried = [self._seen(frame, one.shifted(*shift), steps) for one in (shaped,) for shift in SHIFTS]
        return min((one for one in (seen, *tried) if one is not None), key=self._doubt, default=None)

    def _doubt(self, seen: Seen) -> float:
        """How strange what is seen is; above 1 it may be a slip."""
        return max(seen.misfit / (POOR * self._usual), self._strangeness(seen) / STRANGE)

    def _strangeness(self, seen: Seen) -> float:
        """By how much the ring differs from what it usually shows, by the array's light."""
        if self._ring is None:
            return 0.0
        # a slip shows on two sides, and most on one
        sides = np.sqrt(np.mean((seen.ring - self._ring).reshape(4, -1) ** 2, axis=1))
        return float(sides.max() / max(float(seen.light.mean()), TINY))

    def _learn(self, seen: Seen) -> None:
        if self._ring is None:
            self._ring, self._usual = seen.ring, seen.misfit
        if self._doubt(seen) < 1:
            self._ring = (1 - USUAL) * self._ring + USUAL * seen.ring
            self._sure = seen.place
        self._bright = max(float(seen.light.mean()), self._bright / GROWTH)
        # a camera that loses focus is believed in the end
        self._usual = float(np.clip(seen.misfit, self._usual / GROWTH, self._usual * GROWTH))

    def _seen(self, frame: Frame, place: Place, steps: int) -> Seen | None:
        if not inside(place, self._look.side, frame.pixels.shape):
            return None
        seen = self._look(frame.pixels, place, steps)
        good = seen.misfit < LARGEST_MISFIT and inside(seen.place, self._look.side, frame.pixels.shape)
        return seen if good else None
