"""Diagnosis of a filmed screen: number of cells, pattern rate, and causes of a failed reception."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.link.settings import PRESETS
from heliograph.probe.activity import LEAST_FRAMES, Stretch, stretch_of
from heliograph.probe.arrays import Asked
from heliograph.probe.causes import Cause, RegionSeen
from heliograph.probe.headers import HeaderSeen
from heliograph.probe.levels import Levels
from heliograph.probe.light import light_rate
from heliograph.probe.regions import Region, regions_of
from heliograph.receive.screen.clock import ANY_RATES
from heliograph.receive.screen.locate import find_quadrilaterals, mean_change, reduce_frame
from heliograph.receive.sync.frame_clock import frame_period
from heliograph.signal.pwm import SLOT_ORDER
from heliograph.signal.settings import SignalSettings

SIDES = range(8, 33, 4)
"""Cells of a side that are told apart."""

AREA_PX = 672
"""Side to which the array's area is stretched: a whole number of pixels for each cell of 8, 12, 16, 24, 28 and 32."""

CELL_FRAMES = 24
"""Frames that are compared, of a few seconds. Chosen: each shows other edges."""

LEAST_LIKE, LEAST_LIKE_8 = 0.3, 0.45
"""Least correlation with evenly spaced lines. At 30 frames a second, 120 px for 16 cells and more, the right number had
0.34 to 0.8, wrong ones up to 0.2; but 8, on whose lines those of the header lie, up to 0.31."""


def cells_of_a_side(frames: Sequence[Frame]) -> int | None:
    """Return how many cells a side has of the array that some frames show; None where the lines do not tell."""
    some = frames[-4 * CELL_FRAMES :][:: max(1, min(len(frames) // CELL_FRAMES, 4))]
    pixels = np.stack([frame.pixels for frame in some]).astype(np.float32)
    changes = np.asarray(pixels.std(axis=0), np.float64)
    small, factor = reduce_frame(np.asarray(changes, np.float32))
    for corners in find_quadrilaterals(np.asarray(small, np.float64), factor):
        lines = _lines(pixels, sharpen_corners(np.asarray(changes, np.float32), corners, factor))
        like = {side: _like(lines, side) for side in SIDES}
        best = max(like, key=lambda side: like[side])
        if like[best] >= (LEAST_LIKE_8 if best == SIDES[0] else LEAST_LIKE):
            return best
    return None


def _lines(pixels: NDArray[np.float32], corners: Floats) -> Floats:
    """(AREA_PX - 1,) mean step from pixel to pixel across the array, along both directions, less its slow part."""
    square = np.array([(0, 0), (AREA_PX, 0), (AREA_PX, AREA_PX), (0, AREA_PX)], np.float32) - np.float32(0.5)
    warp = cv2.getPerspectiveTransform(np.asarray(corners, np.float32), square)
    profile = np.zeros(AREA_PX - 1)
    for one in pixels:
        area = cv2.warpPerspective(one, warp, (AREA_PX, AREA_PX))
        profile += np.abs(np.diff(area, axis=1)).mean(axis=0) + np.abs(np.diff(area, axis=0)).mean(axis=1)
    slow = cv2.GaussianBlur(profile[None], (0, 0), AREA_PX / SIDES[0] / 2)[0]
    return np.asarray(profile - slow, np.float64)


def _like(lines: Floats, side: int) -> float:
    """Correlation of steps with lines between so many cells, those within the outer two cells left out."""
    cell = AREA_PX / side
    places = np.arange(1, AREA_PX) / cell
    # Standard deviation of a line in cells, which the lens' blur makes. Chosen: of 0.1 to 0.3 all tell the same
    drawn = np.exp(-0.5 * ((places - np.round(places)) / 0.18) ** 2)
    inner = slice(AREA_PX // 16, -AREA_PX // 16)
    a, b = lines[inner] - lines[inner].mean(), drawn[inner] - drawn[inner].mean()
    return float(a @ b / max(np.sqrt((a @ a) * (b @ b)), TINY))


def sharpen_corners(changes: NDArray[np.float32], corners: Floats, factor: int) -> Floats:
    """Refine corners by the edges of the changes at full resolution."""
    reach = 2.5 * factor + 1
    for _ in range(3):
        lines = [_edge(changes, corners[k], corners[(k + 1) % 4], corners.mean(0), reach) for k in range(4)]
        moved = np.array([_crossing(lines[k - 1], lines[k]) for k in range(4)])
        if not np.isfinite(moved).all() or np.abs(moved - corners).max() > 2 * reach:
            return corners
        is_done = np.abs(moved - corners).max() < 0.1
        corners = moved
        if is_done:
            break
    return corners


def _edge(
    changes: NDArray[np.float32], start: Floats, end: Floats, middle: Floats, reach: float
) -> tuple[Floats, Floats]:
    """Fit the edge near a side; return a point and the direction."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / max(length, TINY)
    out = np.array([along[1], -along[0]])
    if (start - middle) @ out < 0:
        out = -out
    across = np.linspace(-reach, reach, 2 * int(4 * reach) + 1)
    places = np.linspace(0.06, 0.94, 32) * length
    points = start + places[:, None, None] * along + across[:, None] * out
    x, y = (np.asarray(points[..., k], np.float32) for k in (0, 1))
    profiles = np.asarray(cv2.remap(changes, x, y, cv2.INTER_LINEAR), np.float64)
    inside = np.median(profiles[:, : len(across) // 3], axis=1)
    outside = np.median(profiles[:, -len(across) // 4 :], axis=1)
    strong = inside - outside > 0.4 * np.median(inside)
    if strong.sum() < 8:
        return start, along
    # a blurred edge is at half the height
    over = profiles > ((inside + outside) / 2)[:, None]
    last = len(across) - 1 - np.argmax(over[:, ::-1], axis=1)
    offsets = across[last] + (across[1] - across[0]) / 2
    weight = strong.astype(float)
    fit = np.array([np.median(offsets[strong]), 0.0])
    columns = np.column_stack([np.ones(len(places)), places / length - 0.5])
    for _ in range(8):
        far = np.abs(offsets - columns @ fit)
        # an edge 2 px off counts a quarter
        w = weight / (1 + (far / 2) ** 2) ** 2
        fit = np.linalg.lstsq(columns * w[:, None], offsets * w, rcond=None)[0]
    a, b = (start + s * length * along + (fit[0] + fit[1] * (s - 0.5)) * out for s in (0.0, 1.0))
    return a, b - a


def _crossing(first: tuple[Floats, Floats], second: tuple[Floats, Floats]) -> Floats:
    """Intersect two lines, each a point and a direction."""
    (p, d), (q, e) = first, second
    across = d[0] * e[1] - d[1] * e[0]
    if abs(across) < TINY:
        return np.full(2, np.nan)
    t = ((q[0] - p[0]) * e[1] - (q[1] - p[1]) * e[0]) / across
    return p + t * d


DISPLAYS_HZ = (60, 50, 72, 75, 90, 100, 120, 144, 165, 240)
"""Refreshes a second of usual displays, the most usual one first."""

OFFERED_HZ = (1, 2, 5, 10, 15, 20, 30, 60, 120)
"""Patterns a second about which page *Transmit* offers those that divide the display's refreshes."""

USUAL_HZ = [display / max(1, round(display / rate)) for display in DISPLAYS_HZ for rate in OFFERED_HZ]
"""Patterns a second that are taken for meant where one is near."""

NEAR = 0.01
"""Departure from a usual rate, as a fraction, that is taken for the measurement's. Chosen: three times that of 7 s."""

CEILING = 255
"""Full scale of 8 bits."""


def patterns_per_s(frames: Sequence[Frame]) -> float | None:
    """Return how many patterns a second some frames show; None where nothing blinks as patterns do."""
    # every so many frames are looked at: a pattern of 1 s lasts 30 frames, more than `light_rate` tries
    told = [one for step in (1, 4) for one in _told(frames[::step])]
    return usual(max(told)[1]) if told else None


def _told(frames: Sequence[Frame]) -> Iterator[tuple[float, float]]:
    """How well a rate explains what a region shows, and the rate in patterns a second, for each region that tells."""
    if len(frames) < LEAST_FRAMES:
        return
    stretch = stretch_of(frames)
    regions, _ = regions_of(stretch, CEILING)
    period_s = frame_period(np.array([b.time_s - a.time_s for a, b in pairwise(frames)]))
    for region in regions:
        found = light_rate(stretch.frames, region, float(np.median(stretch.noise)), CEILING, SLOT_ORDER)
        if found is not None:
            yield found.explained, 1 / (found.frames * period_s)


def usual(rate_hz: float) -> float:
    """Return the usual rate near a measured one, or the measured one where none is."""
    for known, near in ((USUAL_HZ[: len(OFFERED_HZ)], NEAR / 2), (USUAL_HZ, NEAR)):
        nearest = min(known, key=lambda one: abs(one / rate_hz - 1))
        if abs(nearest / rate_hz - 1) < near:
            return float(nearest)
    return rate_hz


SLANTED = 1.6
"""Ratio of the sides, or of the diagonals, from which on the array is seen from a side. Chosen: at 45 degrees it is
1.5, and all is read still; a phone can nearly always do better."""

CELL_PX = 5.0
"""Px a cell below which more would help: see `docs/how-to/film-a-screen.md`. In good light 2.3 px were read."""

WEAK = 0.2
"""Light of the array over full scale below which it is glare, or a dim screen. Chosen: of one in a lit room it is
0.5."""

FEWEST_FRAMES = 1.7
"""Frames to a pattern below which the rate is too high: rows see two patterns in nearly all frames."""

SAME_RATE = 0.02
"""Departure from a rate that the receiver tries, as a fraction, up to which it is that one: the receiver's own."""

CLEAR, MOST_LIGHT = 0.9, 1.2
"""Correlation with a header, and light over full scale, of a fit that is believed: in strong noise, and of an array
seen from a side, fits with 0.83 to 0.88 had the light of 1.4 to 2.5 full scales."""

FITS, MOVES = 1.25, 0.85
"""Sizes of a header over that of the area that changes up to which they are the same thing, and below which the area is
wide because it moves: of a hand that went 20 px to either side it was 0.82, of one that went 12 px 0.88."""

BRIGHT, DARK = 0.8, 0.15
"""Median level over full scale of a picture that is nearly white; brightest level of one that is dark. Chosen."""

PHONES_HZ = 20.0, 250.0
"""Frames a second of phones' films."""


@dataclass(frozen=True, slots=True)
class _Shown:
    """What is known of a screen's array: how large, how bright, how blurred, how fast."""

    corners: Floats
    seen: RegionSeen
    asked: Asked
    rate_hz: float | None
    cells: int | None
    size: tuple[int, int]
    full_scale: int

    @property
    def side_px(self) -> float:
        """Mean side in px: the header's where it is believed, else that of the area that changes."""
        header = self.seen.header
        return header.size_px if header is not None and self.believed else self.area_px

    @property
    def area_px(self) -> float:
        """Mean side in px of the area that changes."""
        return _side_px(self.corners)

    @property
    def cell_px(self) -> float:
        """Side of a cell in px, if there are as many as asked for."""
        return self.side_px / self.asked.signal.side

    @property
    def slant(self) -> float:
        """Longest side over the shortest, or the same of the diagonals: 1 of a square."""
        sides = np.linalg.norm(np.roll(self.corners, -1, axis=0) - self.corners, axis=1)
        diagonals = np.linalg.norm(self.corners[2:] - self.corners[:2], axis=1)
        return float(max(sides.max() / sides.min(), diagonals.max() / diagonals.min()))

    @property
    def believed(self) -> bool:
        """Whether the header's fit is that of the array, so that its blur and size count."""
        header = self.seen.header
        if header is None or header.score < CLEAR or header.fit.gain > MOST_LIGHT * self.full_scale:
            return False
        return self.slant < SLANTED and header.size_px < FITS * self.area_px

    @property
    def light(self) -> float:
        """Light of the array over full scale; where frames see two patterns the header has less of it than the rest."""
        header = self.seen.header
        gain = header.fit.gain / self.full_scale if header is not None and self.believed else 0.0
        return max(gain, self.seen.region.contrast)

    @property
    def is_burnt(self) -> bool:
        """True if it is overexposed."""
        # Overexposed part of the array above which levels are lost: with the two upper ones of five (PWM, eq. (1)) it
        # is 5 of 16 cells of random data. All was read at 0.34 in good light, an eighth at 0.8
        return self.seen.region.saturated > 0.25

    @property
    def moves(self) -> bool:
        """Whether the area that changes is larger than the array, as a hand moves it."""
        header = self.seen.header
        return header is not None and self.believed and header.size_px < MOVES * self.area_px

    @property
    def frames_a_pattern(self) -> float | None:
        """Frames that a pattern lasts; None where the light does not tell."""
        return None if self.rate_hz is None else self.asked.rate_hz / self.rate_hz

    @property
    def is_cut(self) -> bool:
        """Whether it reaches the picture's border, or nearly."""
        # Cells between the array and the picture's border below which the array is not found: the receiver asks that
        # nothing changes beside it. Of 16 x 16 cells that were cut 0.6 cells beside the array nothing was read
        rim = self.area_px / self.asked.signal.side
        inside = (self.corners > rim) & (self.corners < np.array(self.size) - 1 - rim)
        return self.seen.region.at_border or not bool(inside.all())


@dataclass(frozen=True, slots=True)
class ScreenLook:
    """A screen in a film that is not read: where most of it changes as patterns do, and why it is not read."""

    # The liveliest frames of the film; None where it has too few
    stretch: Stretch | None
    # (4, 2) corners in px, clockwise; None where nothing changes as patterns do
    corners: Floats | None
    # What it was to be read with
    asked: Asked
    # Gray levels of some frames
    levels: Levels

    @classmethod
    def of(cls, stretch: Stretch | None, asked: Asked, levels: Levels) -> "ScreenLook":
        """Look where the screen is."""
        return cls(stretch, None if stretch is None else area_of(stretch.frames), asked, levels)

    def regions(self, regions: Sequence[Region]) -> tuple[list[Region], int]:
        """Return the region of the screen, one at most, and how many there are."""
        if self.corners is None:
            return [], 0
        x, y = self.corners.mean(axis=0)
        outline = self.corners.astype(np.float32)

        def is_of_it(one: Region) -> bool:
            # of an array in strong noise a part alone may stand out
            holds = 2 * abs(one.x - x) < one.width and 2 * abs(one.y - y) < one.height
            return holds or cv2.pointPolygonTest(outline, (one.x, one.y), False) >= 0

        found = [one for one in regions if is_of_it(one)][:1]
        return found, len(found)

    def causes(self, seen: RegionSeen) -> tuple[Cause, ...]:
        """Tell why a screen is not read, the gravest cause first; one of the kind "unread" where all looks well."""
        assert self.stretch is not None
        assert self.corners is not None
        frames, corners, region = self.stretch.frames, self.corners, seen.region
        # Size of the area that changes over the region's below which it is a part of it. Chosen: of arrays that nearly
        # fill the picture a few cells may stand out of the rest
        if _side_px(corners) < 0.6 * region.side:
            corners = region.corners
        rate = patterns_per_s(frames) if frames[0].bits == 8 else None
        rows, columns = frames[0].pixels.shape
        full_scale = frames[0].full_scale
        shown = _Shown(corners, seen, self.asked, rate, cells_of_a_side(frames), (columns, rows), full_scale)
        return tuple(_causes(shown)) or (_unread(shown),)

    def nothing_seen(self) -> tuple[Cause, ...]:
        """Why nothing is seen that changes as patterns do."""
        return tuple(_nothing_seen(self.levels))


def screen_cause(frames: Sequence[Frame], rate_hz: float) -> Cause | None:
    """Recognise a film of a screen that was to be read as one of an LED array."""
    if not PHONES_HZ[0] <= rate_hz <= PHONES_HZ[1] or frames[0].bits != 8 or (area := area_of(frames)) is None:
        return None
    cells = cells_of_a_side(frames)
    # least px a cell of a screen that is recognised without being asked for: LEDs of arrays lie 1 to 3 px apart
    if cells is None or _side_px(area) < 3.0 * cells:
        return None
    patterns_hz = patterns_per_s(frames)
    if patterns_hz is None or rate_hz < FEWEST_FRAMES * patterns_hz:
        return None
    periods = {name: changes["signal"]["pattern_period_s"] for name, (_, changes) in PRESETS.items() if "phone" in name}
    preset = min(periods, key=lambda name: abs(np.log(periods[name] * patterns_hz)))
    side = "" if cells == SignalSettings().side else f" --set signal.side={cells}"
    return Cause(
        "screen",
        f"the film shows a screen: {cells} x {cells} cells, {patterns_hz:.3g} patterns a second, {rate_hz:.3g} frames "
        f"a second",
        (f"read it by --preset {preset}{side}, which chooses --receiver screen",),
    )


def films_causes(causes: Sequence[Cause]) -> tuple[Cause, ...]:
    """Of what is the matter with a film that which is told of a screen's, too."""
    # what is told of a screen's film as of any other; the rest is told by the array itself
    return tuple(
        one for one in causes if one.kind in ("lost frames", "repeated frames", "still", "other bits", "short")
    )


def _side_px(corners: Floats) -> float:
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean())


def area_of(frames: Sequence[Frame]) -> Floats | None:
    """Return where most changes as patterns do: (4, 2) corners in px, clockwise; None where nothing does."""
    # Frames whose changes show where the array is. Chosen: a second of a phone's
    some = frames[:: max(1, len(frames) // 32)]
    if len(some) < 2:
        return None
    changes = mean_change([np.asarray(one.pixels / one.full_scale, np.float32) for one in some])
    small, factor = reduce_frame(changes)
    found = find_quadrilaterals(small, factor)
    return found[0] if found else None


def _nothing_seen(levels: Levels) -> Iterator[Cause]:
    if levels.percentiles.get(50, 0) > BRIGHT * levels.full_scale:
        yield Cause("exposure", "the picture is nearly white", (
            "touch the patterns in the phone's picture, or lower the brightness of the screen",))  # fmt: skip
    elif levels.brightest < DARK * levels.full_scale:
        yield Cause("exposure", "the picture is nearly black", (
            "make the screen brighter, and touch the patterns in the phone's picture",))  # fmt: skip
    yield Cause("sight", "nothing changes as patterns do", (
        "see that the screen is in the picture, not paused, and fills a third of it; hold still",))  # fmt: skip


def _causes(shown: _Shown) -> Iterator[Cause]:
    light = tuple(_light(shown))
    if shown.is_burnt:  # white blots have neither the outline nor the header of the array
        yield from light
        return
    yield from _place(shown)
    yield from light
    yield from _sharpness(shown)
    yield from _number(shown)
    yield from _pace(shown)


def _place(shown: _Shown) -> Iterator[Cause]:
    if shown.is_cut:
        yield Cause("sight", "the patterns reach the picture's border", (
            "show all of the patterns, with a dark margin of two cells about them",))  # fmt: skip
    if shown.slant >= SLANTED:
        yield Cause("angle", f"the patterns are seen from a side: one way they are {shown.slant:.1f} times as long", (
            "hold the phone straight before the screen",))  # fmt: skip
    if shown.moves:
        yield Cause("motion", "the patterns move in the picture", (
            "hold the phone still, by both hands or against something",))  # fmt: skip


def _light(shown: _Shown) -> Iterator[Cause]:
    level = float(np.mean(shown.seen.region.brightness)) / shown.full_scale
    if shown.is_burnt:
        part = 100 * shown.seen.region.saturated
        yield Cause("exposure", f"{part:.0f} % of the patterns are white blots, whose levels are lost", (
            "lower the brightness of the screen, or the exposure by touching the patterns in the phone's picture",
        ))  # fmt: skip
    # Mean gray level of a weak array over full scale from which on something shines on it; below it is dark. Chosen
    elif shown.light < WEAK and level > 0.5:
        yield Cause("glare", f"the patterns' light is {100 * shown.light:.0f} % of full scale, on a bright ground", (
            "turn off lamps behind you, turn the screen from windows, and make it brighter",))  # fmt: skip
    elif shown.light < WEAK:
        yield Cause("exposure", f"the patterns are dark: their light is {100 * shown.light:.0f} % of full scale", (
            "make the screen brighter, and touch the patterns in the phone's picture",))  # fmt: skip


def _sharpness(shown: _Shown) -> Iterator[Cause]:
    header = shown.seen.header
    if shown.cell_px < CELL_PX:
        yield Cause("resolution", f"a cell has {shown.cell_px:.1f} px; {CELL_PX:g} or more are read in a hand", (
            "go nearer, zoom in before filming, or film in 1080p",
            "or show fewer cells: on page Transmit, or by --set signal.side=8 at both ends"))  # fmt: skip
    elif shown.believed and not shown.moves and header is not None and _is_blurred(header):
        blur = header.fit.pose.blur / header.fit.pose.pitch
        yield Cause("focus", f"the patterns are blurred by {blur:.1f} cells", (
            "touch the patterns in the phone's picture, wipe the lens, go 30 cm away at least; hold the phone still",
        ))  # fmt: skip


def _is_blurred(header: HeaderSeen) -> bool:
    # blur of the header's fit over the pitch from which on focus would help: in focus it is 0.4, as cells are square;
    # at 0.66 all is read, at 0.8 half of the codewords, at 1 hardly any
    return header.fit.pose.blur > 0.7 * header.fit.pose.pitch


def _number(shown: _Shown) -> Iterator[Cause]:
    side, cells = shown.asked.signal.side, shown.cells
    if cells is not None and cells != side and shown.believed and not shown.moves:
        yield Cause("cells", f"the screen shows {cells} x {cells} cells, not {side} x {side}", (
            f"say so: on page Receive, or by --set signal.side={cells}",))  # fmt: skip


def _pace(shown: _Shown) -> Iterator[Cause]:
    frames, rate = shown.frames_a_pattern, shown.rate_hz
    if frames is None or rate is None:
        return
    if frames < FEWEST_FRAMES:
        yield Cause("rate", f"a pattern lasts {frames:.1f} frames of the film; two or more are read", (
            "choose fewer patterns a second, or film at more frames a second",))  # fmt: skip
    elif not _looked_for(rate, shown.asked):
        yield Cause("rate", f"the screen shows {rate:.3g} patterns a second, which are not looked for", (
            f"say so: on page Receive, or by --set signal.pattern_period_s={1 / rate:.3g}",
            "or, where it is slow motion that plays slower than it was filmed, by --fps RATE"))  # fmt: skip


def _looked_for(rate: float, asked: Asked) -> bool:
    """Whether the receiver looks for so many patterns a second."""
    own = abs(rate * asked.signal.pattern_period_s - 1) < SAME_RATE
    low, high = (1 - SAME_RATE) * ANY_RATES[0], (1 + SAME_RATE) * ANY_RATES[-1]
    return own or (asked.settings.screen.find_rate and low < rate < high)


def _unread(shown: _Shown) -> Cause:
    size = f"an array of {shown.side_px:.0f} px is seen"
    if shown.rate_hz is None:
        return Cause("unread", f"{size}, but its patterns follow no even clock", (
            "see that no refresh of the display is skipped: page Transmit counts them; choose fewer patterns a second",
            "film two packets at least, without moving the phone"))  # fmt: skip
    return Cause("unread", f"{size}, and its patterns follow a clock, but no packet is read", (
        "film two packets at least, without moving the phone",
        "see that both ends have the same settings: signal.side, signal.data_pairs, signal.rate"))  # fmt: skip
