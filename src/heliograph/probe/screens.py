"""Diagnosis of a filmed screen: number of cells, pattern rate, and causes of a failed reception."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.link.settings import PRESETS, LinkSettings
from heliograph.media import FilmReader
from heliograph.media.live.reader import live_of
from heliograph.probe.activity import LEAST_FRAMES, stretch_of
from heliograph.probe.arrays import Setup
from heliograph.probe.causes import Cause, RegionMeasures, RegionReport, Rule, diagnose
from heliograph.probe.levels import Levels
from heliograph.probe.light import light_rate
from heliograph.probe.regions import Region, regions_of
from heliograph.receive.api import choose_receiver
from heliograph.receive.screen.clock import ANY_RATES
from heliograph.receive.screen.locate import find_quadrilaterals, mean_change, reduce_frame
from heliograph.receive.sync.frame_clock import frame_period
from heliograph.signal.pwm import SLOT_ORDER
from heliograph.signal.settings import SignalSettings

SIDES = (*range(8, 33, 4), 48, 64, 96, 128)  # distinguished numbers of cells per side

# Side of the upright array in px: an integer number of pixels per cell of most `SIDES`
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
    """Correlate steps with the edges of cells, except the outer two of 32 or eight of 128 cells."""
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
        edges = [_edge(changes, corners[k], corners[(k + 1) % 4], corners.mean(0), reach) for k in range(4)]
        crossings = np.array([np.cross(edges[k - 1], edges[k]) for k in range(4)])
        moved = crossings[:, :2] / (crossings[:, 2:] + TINY)
        if np.abs(moved - corners).max() > 2 * reach:
            return corners
        shift, corners = np.abs(moved - corners).max(), moved
        if shift < 0.1:
            break
    return corners


def _edge(changes: NDArray[np.float32], start: Floats, end: Floats, middle: Floats, reach: float) -> Floats:
    """Fit the edge near a side as homogeneous line (a, b, c) with a x + b y + c = 0."""
    out = np.array([end[1] - start[1], start[0] - end[0]]) / max(float(np.linalg.norm(end - start)), TINY)
    out *= np.copysign(1.0, (start - middle) @ out)
    across = np.linspace(-reach, reach, 2 * int(4 * reach) + 1)
    base = start + np.linspace(0.06, 0.94, 32)[:, None] * (end - start)
    points = (base[:, None] + across[:, None] * out).astype(np.float32)
    profiles = cv2.remap(changes, points[..., 0], points[..., 1], cv2.INTER_LINEAR)
    inside = np.median(profiles[:, : len(across) // 3], axis=1)
    outside = np.median(profiles[:, -len(across) // 4 :], axis=1)
    strong = inside - outside > 0.4 * np.median(inside)
    if strong.sum() < 8:
        return np.cross([*start, 1], [*end, 1])
    # a blurred edge is at half the height
    over = profiles > ((inside + outside) / 2)[:, None]
    offsets = across[len(across) - 1 - np.argmax(over[:, ::-1], axis=1)] + (across[1] - across[0]) / 2
    edge = (base + offsets[:, None] * out)[strong].astype(np.float32)
    # an edge 2 px off counts little
    dx, dy, x, y = cv2.fitLine(edge, cv2.DIST_WELSCH, 2.0, 0.01, 0.01).ravel().astype(np.float64)
    return np.array([dy, -dx, dx * y - dy * x])


# Refresh rates of displays, the most usual first, and the pattern rates of page *Transmit*
DISPLAYS_HZ = (60, 50, 72, 75, 90, 100, 120, 144, 165, 240)
OFFERED_HZ = (1, 2, 5, 10, 15, 20, 30, 60, 120)


def patterns_per_s(frames: Sequence[Frame]) -> float | None:
    """Return the pattern rate of some frames of 8 bits; None if they show no patterns."""
    # every fourth frame: a pattern of 1 s lasts 30 frames, above the limit of `light_rate`
    rates = []
    for part in (frames, frames[::4]):
        if len(part) < LEAST_FRAMES:
            break
        stretch, period_s = stretch_of(part), frame_period(np.diff([frame.time_s for frame in part]))
        for region in regions_of(stretch, 255)[0]:
            found = light_rate(part, region, float(np.median(stretch.noise)), 255, SLOT_ORDER)
            if found is not None:
                rates.append((found.explained, 1 / (found.frames * period_s)))
    return usual(max(rates)[1]) if rates else None


def usual(rate_hz: float) -> float:
    """Return the usual pattern rate near a measured rate, or the measured rate."""
    rates = [display / max(1, round(display / rate)) for display in DISPLAYS_HZ for rate in OFFERED_HZ]
    # the error of the measurement is 0.3 % after 7 s; the most usual display comes first, with half the tolerance
    for known, tolerance in ((rates[: len(OFFERED_HZ)], 0.005), (rates, 0.01)):
        nearest = min(known, key=lambda known_hz: abs(known_hz / rate_hz - 1))
        if abs(nearest / rate_hz - 1) < tolerance:
            return float(nearest)
    return rate_hz


MAX_SLANT = 1.6  # maximum ratio of sides, or of diagonals: at 45 degrees it is 1.5, and all is decoded
MIN_CELL_PX = 5.0  # minimum px per cell in a hand; in good light 2.3 px are decoded
MIN_FRAMES = 1.7  # minimum frames per pattern: of fewer nearly all frames show two patterns


@dataclass(frozen=True, kw_only=True)
class ScreenMeasures(RegionMeasures):
    """Measured values of a screen's array."""

    corners: Floats
    rate_hz: float | None
    cells: int | None
    size: tuple[int, int]

    side = property(lambda self: self.setup.signal.side)
    area_px = property(lambda self: _side_px(self.corners))
    # mean side in px, by a reliable header fit, or by the changing area
    side_px = property(lambda self: self.header.size_px if self.is_reliable else self.area_px)
    cell_px = property(lambda self: self.side_px / self.side)
    percent = property(lambda self: 100 * self.light)
    # 0.34 is decoded in good light, of 0.8 an eighth
    is_burnt = property(lambda self: self.region.saturated > 0.25)
    # in a lit room the array has half of full scale; without header, data that are decoded have a contrast of 0.06
    is_weak = property(lambda self: self.light < (0.2 if self.is_reliable else 0.05))
    is_bright = property(lambda self: np.mean(self.region.brightness) / self.full_scale > 0.5)
    # the changing area is larger than the array due to motion of the hand: 20 px to either side have a ratio of 0.82,
    # 12 px have 0.88
    moves = property(lambda self: self.is_reliable and self.side_px < 0.85 * self.area_px)
    pattern_s = property(lambda self: 1 / self.rate_hz)
    frames = property(lambda self: self.setup.rate_hz / self.rate_hz if self.rate_hz else np.inf)

    @property
    def slant(self) -> float:
        """Ratio of the longest to the shortest side, or of the diagonals: 1 for a square."""
        sides = np.linalg.norm(np.roll(self.corners, -1, axis=0) - self.corners, axis=1)
        diagonals = np.linalg.norm(self.corners[2:] - self.corners[:2], axis=1)
        return float(max(sides.max() / sides.min(), diagonals.max() / diagonals.min()))

    @property
    def is_reliable(self) -> bool:
        """True if the header's fit gives blur and size of the array."""
        header = self.header
        if header is None or self.slant >= MAX_SLANT or header.size_px >= 1.25 * self.area_px:
            return False
        # wrong fits have scores of 0.83 to 0.88, and light of 1.4 to 2.5 of full scale
        return header.score >= 0.9 and header.fit.gain <= 1.2 * self.full_scale

    @property
    def light(self) -> float:
        """Light over full scale; frames with two patterns show less in the header than in the data."""
        gain = self.header.fit.gain / self.full_scale if self.header is not None and self.is_reliable else 0.0
        return max(gain, self.region.contrast)

    @property
    def is_cut(self) -> bool:
        """True if the array is less than a cell from the image's border, which must not change."""
        rim = self.area_px / self.side
        inside = (self.corners > rim) & (self.corners < np.array(self.size) - 1 - rim)
        return self.region.at_border or not bool(inside.all())

    @property
    def is_expected_rate(self) -> bool:
        """True if the receiver tries the rate of the patterns."""
        rate_hz = self.rate_hz or 0.0
        is_given = abs(rate_hz * self.setup.signal.pattern_period_s - 1) < 0.02
        is_tried = 0.98 * ANY_RATES[0] < rate_hz < 1.02 * ANY_RATES[-1]
        return is_given or (self.setup.settings.screen.find_rate and is_tried)


SCREEN: tuple[Rule[ScreenMeasures], ...] = (
    Rule("exposure", lambda m: m.is_burnt, "{m.saturated:.0f} % of the patterns are white blots, levels are lost",
         "lower the brightness of the screen, or the exposure by touching the patterns in the phone's picture"),
    Rule("sight", lambda m: m.is_cut, "the patterns reach the picture's border",
         "show all of the patterns, with a dark margin of two cells about them"),
    Rule("angle", lambda m: m.slant >= MAX_SLANT,
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
    Rule("resolution", lambda m: m.cell_px < MIN_CELL_PX,
         f"a cell has {{m.cell_px:.1f}} px; {MIN_CELL_PX:g} or more are read in a hand",
         "go nearer, zoom in before filming, or film in 1080p",
         "or show fewer cells: on page Transmit, or by --set signal.side=8 at both ends"),
    # square cells in focus have a blur of 0.4 cells; 0.66 is decoded, of 0.8 half
    Rule("focus", lambda m: m.cell_px >= MIN_CELL_PX and m.is_reliable and not m.moves and m.blur > 0.7,
         "the patterns are blurred by {m.blur:.1f} cells",
         "touch the patterns in the phone's picture, wipe the lens, go 30 cm away at least; hold the phone still"),
    Rule("cells", lambda m: m.cells not in (None, m.side) and m.is_reliable and not m.moves,
         "the screen shows {m.cells} x {m.cells} cells, not {m.side} x {m.side}",
         "change the setting: on page Receive, or by --set signal.side={m.cells}"),
    Rule("rate", lambda m: m.frames < MIN_FRAMES,
         "a pattern lasts {m.frames:.1f} frames of the film; two or more are read",
         "choose fewer patterns a second, or film at more frames a second"),
    Rule("rate", lambda m: m.rate_hz and m.frames >= MIN_FRAMES and not m.is_expected_rate,
         "the screen shows {m.rate_hz:.3g} patterns a second, a rate out of range",
         "change the setting: on page Receive, or by --set signal.pattern_period_s={m.pattern_s:.3g}",
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


def screen_film_causes(causes: Sequence[Cause], levels: Levels, is_blank: bool) -> tuple[Cause, ...]:
    """Return the causes of a film that apply to screens; more if no screen is visible."""
    kinds = ("lost frames", "repeated frames", "still", "other bits", "short")
    missing = diagnose(MISSING, levels) if is_blank else ()
    return (*missing, *(cause for cause in causes if cause.kind in kinds))


def regions_in(area: Floats, regions: Sequence[Region]) -> list[Region]:
    """Return the region of the screen, at most one."""
    (x, y), outline = area.mean(axis=0), area.astype(np.float32)
    for region in regions:
        # in strong noise only a part of the array may show
        holds = 2 * abs(region.x - x) < region.width and 2 * abs(region.y - y) < region.height
        if holds or cv2.pointPolygonTest(outline, (region.x, region.y), False) >= 0:
            return [region]
    return []


def screen_causes(report: RegionReport, area: Floats, frames: Sequence[Frame], setup: Setup) -> tuple[Cause, ...]:
    """Return the causes of a screen in an area, the most important first."""
    # if an array nearly fills the picture, a few cells may stand out
    corners = report.region.corners if _side_px(area) < 0.6 * report.region.side else area
    rate_hz = patterns_per_s(frames) if frames[0].bits == 8 else None
    size, full_scale = (frames[0].pixels.shape[1], frames[0].pixels.shape[0]), frames[0].full_scale
    measured = ScreenMeasures(
        setup=setup, full_scale=full_scale, corners=corners, rate_hz=rate_hz, cells=cells_of_a_side(frames), size=size,
        **vars(report),
    )  # fmt: skip
    causes = diagnose(SCREEN, measured) or diagnose(UNREAD, measured)
    # neither outline nor header of an overexposed array show
    return causes[:1] if measured.is_burnt else causes


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
    if patterns_hz is None or rate_hz < MIN_FRAMES * patterns_hz:
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


def with_receiver_for(film: FilmReader, signal: SignalSettings, link: LinkSettings) -> tuple[LinkSettings, str]:
    """Return settings with the receiver for a film, and a line on the choice."""
    name, reason = choose_receiver(signal, film.rate_hz)
    frames = [] if live_of(film) is not None or film.rate_hz > 250 else list(islice(film, 96))
    screen = screen_cause(frames, film.rate_hz) if frames else None
    if screen is not None:
        name, reason = "screen", screen.why
    elif name == "screen":
        # a film in slow motion may state another rate, which "plain" reports
        name = "plain"
    return replace(link, receive=replace(link.receive, receiver=name)), f"receiver {name}: {reason}"
