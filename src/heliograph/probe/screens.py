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
from heliograph.probe.activity import LEAST_FRAMES, stretch_of
from heliograph.probe.arrays import Setup
from heliograph.probe.causes import Cause, RegionReport, Rule, diagnose
from heliograph.probe.levels import Levels
from heliograph.probe.light import light_rate
from heliograph.probe.regions import Region, regions_of
from heliograph.receive.screen.clock import ANY_RATES
from heliograph.receive.screen.locate import find_quadrilaterals, mean_change, reduce_frame
from heliograph.receive.sync.frame_clock import frame_period
from heliograph.signal.pwm import SLOT_ORDER
from heliograph.signal.settings import SignalSettings

SIDES = range(8, 33, 4)
"""Distinguished numbers of cells per side."""

# Side of the upright array in px: an integer number of pixels per cell of 8, 12, 16, 24, 28 and 32
AREA_PX = 672


def cells_of_a_side(frames: Sequence[Frame]) -> int | None:
    """Return the number of cells per side of the array in some frames; None if the cells' edges do not show."""
    # 24 frames over a few seconds: each shows other edges
    used = frames[-96:][:: max(1, min(len(frames) // 24, 4))]
    pixels = np.stack([frame.pixels for frame in used]).astype(np.float32)
    changes = pixels.std(axis=0)
    small, factor = reduce_frame(changes)
    for corners in find_quadrilaterals(small, factor):
        steps = _mean_steps(pixels, sharpen_corners(changes, corners, factor))
        match = {side: _correlate_edges(steps, side) for side in SIDES}
        best = max(match, key=lambda side: match[side])
        # at 30 frames/s and 120 px for 16 cells, right numbers have 0.34 to 0.8, wrong numbers up to 0.2; but 8, with
        # the edges of the header's cells, has up to 0.31
        if match[best] >= (0.45 if best == SIDES[0] else 0.3):
            return best
    return None


def _mean_steps(pixels: NDArray[np.float32], corners: Floats) -> Floats:
    """Return the mean step from pixel to pixel along both directions of the array, high-pass filtered."""
    square = np.array([(0, 0), (AREA_PX, 0), (AREA_PX, AREA_PX), (0, AREA_PX)], np.float32) - np.float32(0.5)
    warp = cv2.getPerspectiveTransform(np.asarray(corners, np.float32), square)
    profile = np.zeros(AREA_PX - 1)
    for image in pixels:
        area = cv2.warpPerspective(image, warp, (AREA_PX, AREA_PX))
        profile += np.abs(np.diff(area, axis=1)).mean(axis=0) + np.abs(np.diff(area, axis=0)).mean(axis=1)
    return np.asarray(profile - cv2.GaussianBlur(profile[None], (0, 0), AREA_PX / SIDES[0] / 2)[0], np.float64)


def _correlate_edges(steps: Floats, side: int) -> float:
    """Correlate steps with the edges of cells, except the outer two of 32 cells."""
    places = np.arange(1, AREA_PX) / (AREA_PX / side)
    # the lens blurs an edge to 0.18 cells
    edges = np.exp(-0.5 * ((places - np.round(places)) / 0.18) ** 2)
    inner = slice(AREA_PX // 16, -AREA_PX // 16)
    a, b = steps[inner] - steps[inner].mean(), edges[inner] - edges[inner].mean()
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


# Refresh rates of displays, the most usual first, and the pattern rates of page *Transmit*
DISPLAYS_HZ = (60, 50, 72, 75, 90, 100, 120, 144, 165, 240)
OFFERED_HZ = (1, 2, 5, 10, 15, 20, 30, 60, 120)


def patterns_per_s(frames: Sequence[Frame]) -> float | None:
    """Return the pattern rate of some frames of 8 bits; None if they show no patterns."""
    # every fourth frame: a pattern of 1 s lasts 30 frames, above the limit of `light_rate`
    rates = [rate for step in (1, 4) for rate in _region_rates(frames[::step])]
    return usual(max(rates)[1]) if rates else None


def _region_rates(frames: Sequence[Frame]) -> Iterator[tuple[float, float]]:
    """Yield the explained part and the pattern rate of each region with patterns."""
    if len(frames) < LEAST_FRAMES:
        return
    stretch = stretch_of(frames)
    regions, _ = regions_of(stretch, 255)
    period_s = frame_period(np.array([b.time_s - a.time_s for a, b in pairwise(frames)]))
    for region in regions:
        found = light_rate(stretch.frames, region, float(np.median(stretch.noise)), 255, SLOT_ORDER)
        if found is not None:
            yield found.explained, 1 / (found.frames * period_s)


def usual(rate_hz: float) -> float:
    """Return the usual pattern rate near a measured rate, or the measured rate."""
    rates = [display / max(1, round(display / rate)) for display in DISPLAYS_HZ for rate in OFFERED_HZ]
    # the error of the measurement is 0.3 % after 7 s; the most usual display comes first, with half the tolerance
    for known, tolerance in ((rates[: len(OFFERED_HZ)], 0.005), (rates, 0.01)):
        nearest = min(known, key=lambda known_hz: abs(known_hz / rate_hz - 1))
        if abs(nearest / rate_hz - 1) < tolerance:
            return float(nearest)
    return rate_hz


@dataclass(frozen=True, slots=True)
class ScreenTuning:
    """Thresholds of the causes of screens."""

    # Minimum ratio of sides, or of diagonals, of an oblique view: at 45 degrees it is 1.5, and all is decoded
    slant: float = 1.6
    # Minimum px per cell in a hand; in good light 2.3 px are decoded
    cell_px: float = 5.0
    # Minimum light of the array over full scale; in a lit room it is 0.5
    light: float = 0.2
    # Minimum gray level over full scale of glare; below it the screen is dark
    glare: float = 0.5
    # Maximum overexposed part: 0.34 is decoded in good light, of 0.8 an eighth
    saturated: float = 0.25
    # Minimum frames per pattern: of fewer nearly all frames show two patterns
    frames: float = 1.7
    # Relative tolerance of the receiver's rates
    rate: float = 0.02
    # Minimum correlation and maximum light over full scale of a reliable header fit: wrong fits have 0.83 to 0.88, and
    # light of 1.4 to 2.5
    header: float = 0.9
    header_light: float = 1.2
    # Maximum size of a reliable header over the changing area, and size below which the area is wide due to motion: 20
    # px to either side have 0.82, 12 px have 0.88
    size: float = 1.25
    motion: float = 0.85
    # Maximum blur in cells: square cells in focus have 0.4; 0.66 is decoded, of 0.8 half
    blur: float = 0.7


TUNING = ScreenTuning()


@dataclass(frozen=True)
class ScreenMeasures:
    """Measured values of a screen's array."""

    corners: Floats
    report: RegionReport
    setup: Setup
    rate_hz: float | None
    cells: int | None
    size: tuple[int, int]
    full_scale: int

    side = property(lambda self: self.setup.signal.side)
    saturated = property(lambda self: 100 * self.report.region.saturated)
    percent = property(lambda self: 100 * self.light)
    blur = property(lambda self: self.report.header.fit.pose.blur / self.report.header.fit.pose.pitch)
    area_px = property(lambda self: _side_px(self.corners))
    cell_px = property(lambda self: self.side_px / self.side)
    is_burnt = property(lambda self: self.report.region.saturated > TUNING.saturated)
    is_weak = property(lambda self: self.light < TUNING.light)
    period_s = property(lambda self: 1 / self.rate_hz)
    frames = property(lambda self: self.setup.rate_hz / self.rate_hz if self.rate_hz else np.inf)

    @property
    def side_px(self) -> float:
        """Mean side in px, by a reliable header fit, or by the changing area."""
        header = self.report.header
        return header.size_px if header is not None and self.is_reliable else self.area_px

    @property
    def slant(self) -> float:
        """Ratio of the longest to the shortest side, or of the diagonals: 1 for a square."""
        sides = np.linalg.norm(np.roll(self.corners, -1, axis=0) - self.corners, axis=1)
        diagonals = np.linalg.norm(self.corners[2:] - self.corners[:2], axis=1)
        return float(max(sides.max() / sides.min(), diagonals.max() / diagonals.min()))

    @property
    def is_reliable(self) -> bool:
        """True if the header's fit gives blur and size of the array."""
        header = self.report.header
        if header is None or header.score < TUNING.header or header.fit.gain > TUNING.header_light * self.full_scale:
            return False
        return self.slant < TUNING.slant and header.size_px < TUNING.size * self.area_px

    @property
    def light(self) -> float:
        """Light over full scale; frames with two patterns show less in the header than in the data."""
        header = self.report.header
        gain = header.fit.gain / self.full_scale if header is not None and self.is_reliable else 0.0
        return max(gain, self.report.region.contrast)

    is_bright = property(lambda self: np.mean(self.report.region.brightness) / self.full_scale > TUNING.glare)
    # the changing area is larger than the array due to motion of the hand
    moves = property(lambda self: self.is_reliable and self.side_px < TUNING.motion * self.area_px)

    @property
    def is_cut(self) -> bool:
        """True if the array is less than a cell from the image's border, which must not change."""
        rim = self.area_px / self.side
        inside = (self.corners > rim) & (self.corners < np.array(self.size) - 1 - rim)
        return self.report.region.at_border or not bool(inside.all())

    @property
    def is_expected_rate(self) -> bool:
        """True if the receiver tries the rate of the patterns."""
        rate_hz, settings = self.rate_hz or 0.0, self.setup.settings.screen
        is_given = abs(rate_hz * self.setup.signal.pattern_period_s - 1) < TUNING.rate
        is_tried = (1 - TUNING.rate) * ANY_RATES[0] < rate_hz < (1 + TUNING.rate) * ANY_RATES[-1]
        return is_given or (settings.find_rate and is_tried)


BURNT: Rule[ScreenMeasures] = Rule(  # neither outline nor header of the array show
    "exposure", lambda m: m.is_burnt, "{m.saturated:.0f} % of the patterns are white blots, levels are lost",
    "lower the brightness of the screen, or the exposure by touching the patterns in the phone's picture",
)  # fmt: skip

SCREEN: tuple[Rule[ScreenMeasures], ...] = (
    Rule("sight", lambda m: m.is_cut, "the patterns reach the picture's border",
         "show all of the patterns, with a dark margin of two cells about them"),
    Rule("angle", lambda m: m.slant >= TUNING.slant,
         "the patterns are seen from a side: one direction is {m.slant:.1f} times as long",
         "hold the phone straight before the screen"),
    Rule("motion", lambda m: m.moves, "the patterns move in the picture",
         "hold the phone still, by both hands or against something"),
    Rule("glare", lambda m: m.is_weak and m.is_bright,
         "the patterns' light is {m.percent:.0f} % of full scale, on a bright ground",
         "turn off lamps behind you, turn the screen from windows, and make it brighter"),
    Rule("exposure", lambda m: m.is_weak and not m.is_bright,
         "the patterns are dark: their light is {m.percent:.0f} % of full scale",
         "make the screen brighter, and touch the patterns in the phone's picture"),
    Rule("resolution", lambda m: m.cell_px < TUNING.cell_px,
         f"a cell has {{m.cell_px:.1f}} px; {TUNING.cell_px:g} or more are read in a hand",
         "go nearer, zoom in before filming, or film in 1080p",
         "or show fewer cells: on page Transmit, or by --set signal.side=8 at both ends"),
    Rule("focus",
         lambda m: m.cell_px >= TUNING.cell_px and m.is_reliable and not m.moves and m.blur > TUNING.blur,
         "the patterns are blurred by {m.blur:.1f} cells",
         "touch the patterns in the phone's picture, wipe the lens, go 30 cm away at least; hold the phone still"),
    Rule("cells", lambda m: m.cells not in (None, m.side) and m.is_reliable and not m.moves,
         "the screen shows {m.cells} x {m.cells} cells, not {m.side} x {m.side}",
         "change the setting: on page Receive, or by --set signal.side={m.cells}"),
    Rule("rate", lambda m: m.frames < TUNING.frames,
         "a pattern lasts {m.frames:.1f} frames of the film; two or more are read",
         "choose fewer patterns a second, or film at more frames a second"),
    Rule("rate", lambda m: m.rate_hz is not None and m.frames >= TUNING.frames and not m.is_expected_rate,
         "the screen shows {m.rate_hz:.3g} patterns a second, a rate out of range",
         "change the setting: on page Receive, or by --set signal.pattern_period_s={m.period_s:.3g}",
         "or, for slow motion that plays slower than it was filmed, by --fps RATE"),
)  # fmt: skip
"""Causes of a visible screen, the most important first."""

UNREAD: tuple[Rule[ScreenMeasures], ...] = (
    Rule("unread", lambda m: m.rate_hz is None,
         "an array of {m.side_px:.0f} px is visible, but the patterns follow no even clock",
         "see that no refresh of the display is skipped: page Transmit counts skips; choose fewer patterns a second",
         "film two packets at least, and hold the phone still"),
    Rule("unread", lambda m: m.rate_hz is not None,
         "an array of {m.side_px:.0f} px is visible, and the patterns follow a clock, but no packet is read",
         "film two packets at least, and hold the phone still",
         "see that both ends have the same settings: signal.side, signal.data_pairs, signal.rate"),
)  # fmt: skip
"""Other causes of a visible screen."""

MISSING: tuple[Rule[Levels], ...] = (
    Rule("exposure", lambda m: m.percentiles[50] > 0.8 * m.full_scale, "the picture is nearly white",
         "touch the patterns in the phone's picture, or lower the brightness of the screen"),
    Rule("exposure", lambda m: m.percentiles[50] <= 0.8 * m.full_scale and m.brightest < 0.15 * m.full_scale,
         "the picture is nearly black", "make the screen brighter, and touch the patterns in the phone's picture"),
    Rule("sight", lambda _: True, "no area changes as patterns do",
         "see that the screen is in the picture, not paused, and fills a third of it; hold still"),
)  # fmt: skip
"""Causes of films with no visible screen."""

SCREEN_FILM = ("lost frames", "repeated frames", "still", "other bits", "short")
"""Kinds of causes of films for screens, too."""


def regions_in(area: Floats | None, regions: Sequence[Region]) -> list[Region]:
    """Return the region of the screen, at most one."""
    if area is None:
        return []
    (x, y), outline = area.mean(axis=0), area.astype(np.float32)

    def is_inside(region: Region) -> bool:
        # in strong noise only a part of the array may show
        holds = 2 * abs(region.x - x) < region.width and 2 * abs(region.y - y) < region.height
        return holds or cv2.pointPolygonTest(outline, (region.x, region.y), False) >= 0

    return [region for region in regions if is_inside(region)][:1]


def screen_causes(report: RegionReport, area: Floats, frames: Sequence[Frame], setup: Setup) -> tuple[Cause, ...]:
    """Return the causes of a screen in an area, the most important first."""
    # if an array nearly fills the picture, a few cells may stand out
    corners = report.region.corners if _side_px(area) < 0.6 * report.region.side else area
    rate_hz = patterns_per_s(frames) if frames[0].bits == 8 else None
    size, full_scale = (frames[0].pixels.shape[1], frames[0].pixels.shape[0]), frames[0].full_scale
    measured = ScreenMeasures(corners, report, setup, rate_hz, cells_of_a_side(frames), size, full_scale)
    return diagnose((BURNT,), measured) or diagnose(SCREEN, measured) or diagnose(UNREAD, measured)


def screen_cause(frames: Sequence[Frame], rate_hz: float) -> Cause | None:
    """Recognise a film of a screen in a film that should show an LED array."""
    # the frame rates of phones
    if not 20.0 <= rate_hz <= 250.0 or frames[0].bits != 8 or (area := area_of(frames)) is None:
        return None
    cells = cells_of_a_side(frames)
    # LEDs of arrays have a pitch of 1 to 3 px
    if cells is None or _side_px(area) < 3.0 * cells:
        return None
    patterns_hz = patterns_per_s(frames)
    if patterns_hz is None or rate_hz < TUNING.frames * patterns_hz:
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


def _side_px(corners: Floats) -> float:
    return float(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).mean())


def area_of(frames: Sequence[Frame]) -> Floats | None:
    """Return the area with most changes like patterns as (4, 2) corners in px, clockwise; None if no area changes."""
    # 32 frames: a second of a phone's film
    used = frames[:: max(1, len(frames) // 32)]
    if len(used) < 2:
        return None
    small, factor = reduce_frame(mean_change([np.asarray(f.pixels / f.full_scale, np.float32) for f in used]))
    found = find_quadrilaterals(small, factor)
    return found[0] if found else None
