"""Light on the sensor in one exposure: background, panels and LEDs along the motion."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.channel.background import Painter
from heliograph.channel.exposure import Lighting, Lit
from heliograph.channel.motion import Motion
from heliograph.channel.optics import add_leds, cover, disc_cubature, normal_table
from heliograph.channel.scene import Pose, centre_scale, homography, project, square
from heliograph.channel.settings import CameraSettings, ChannelSettings
from heliograph.channel.truth import ArrayTruth

Floats = NDArray[np.float64]

SMEAR_PX = 0.25
"""Motion within an exposure up to which an LED's smear counts by its centroid and variance: the fourth cumulant
left out, -0.25^4 / 120, changes the peak of the reference blur by less than 1e-4. Faster exposures are cut into
pieces that move no further."""

NEAREST_M = 0.3
"""An array whose panel is nearer than this to the camera's plane is not rendered."""


@dataclass(frozen=True)
class Stage:
    """All that stays the same through a film."""

    settings: ChannelSettings
    lightings: list[Lighting]
    drive: Motion
    paint: Painter

    def half_m(self, array: int) -> float:
        """Half the side of an array's panel."""
        emitter = self.settings.emitter
        return self.lightings[array].feed.side / 2 * emitter.pitch_m + emitter.panel_margin_m

    def maps(self, array: int, times_s: Floats, pose: Pose) -> tuple[Floats, Floats]:
        """Homography (..., 3, 3) and eye (..., 3) of an array at times."""
        s = self.settings
        return homography(pose, times_s, s.arrays[array], s.distance_m, s.camera)


@dataclass(frozen=True, slots=True)
class Canvas:
    """A window of the sensor: (h, w) float32 light in shares of full scale, and (x, y) of its first pixel."""

    light: NDArray[np.float32]
    corner: tuple[int, int]

    def meets(self, box: NDArray[np.int64]) -> bool:
        """Whether a box (first x, first y, last x, last y) reaches into it."""
        (x, y), (height, width) = self.corner, self.light.shape
        return bool(box[0] < x + width and box[1] < y + height and box[2] >= x and box[3] >= y)


@dataclass(frozen=True)
class PanelView:
    """An array's panel over a block of b frames, at the middle of the exposures, as `optics.cover` takes it."""

    inverse: Floats
    half: Floats
    box: NDArray[np.int64]


@dataclass(frozen=True)
class View:
    """One array over a block of b frames.

    Attributes
    ----------
    homography, eye
        (b, 3, 3) and (b, 3) at the middle of the exposures.
    drift
        (b, 3, 3) change of the homography by second, over the exposure.
    bounds
        (b, 2, 2) least and largest (x, y) of the panel's image within the exposure.
    motion_px
        (b,) largest motion of a corner within the exposure.
    ahead
        (b,) the array lies ahead of the camera and faces it.
    inside
        (b,) all LEDs lie on the sensor.
    pitch_px, roll_rad
        (b,) as in the truth.
    """

    homography: Floats
    eye: Floats
    drift: Floats
    panel: PanelView
    bounds: Floats
    motion_px: Floats
    ahead: NDArray[np.bool_]
    inside: NDArray[np.bool_]
    pitch_px: Floats
    roll_rad: Floats


@dataclass(frozen=True)
class Block:
    """Poses of some frames, worked out together.

    Attributes
    ----------
    index
        (b,) numbers of the frames.
    times_s
        (b, 3) start, middle and end of the exposures.
    """

    index: NDArray[np.int64]
    times_s: Floats
    pose: Pose
    views: tuple[View, ...]


def block_views(stage: Stage, index: NDArray[np.int64]) -> Block:
    """Poses and projections of frames."""
    camera = stage.settings.camera
    start = camera.start_s + index * camera.frame_period_s
    times = start[:, None] + camera.exposure_s * np.array([0, 0.5, 1])
    pose = stage.drive.pose(times)
    return Block(index, times, pose, tuple(_view(stage, k, times, pose) for k in range(len(stage.lightings))))


def _view(stage: Stage, array: int, times_s: Floats, pose: Pose) -> View:
    camera, emitter = stage.settings.camera, stage.settings.emitter
    maps, eye = stage.maps(array, times_s, pose)
    corners, depth = project(maps, square(stage.half_m(array)))
    leds, _ = project(maps[:, 1], square((stage.lightings[array].feed.side - 1) / 2 * emitter.pitch_m))
    size = np.array([camera.width, camera.height])
    scale = centre_scale(maps[:, 1])
    ahead = np.asarray((depth > NEAREST_M).all((1, 2)) & (eye[..., 2] < 0).all(1))
    bounds = np.stack([corners.min((1, 2)), corners.max((1, 2))], 1)
    return View(
        homography=maps[:, 1],
        eye=eye[:, 1],
        drift=(maps[:, 2] - maps[:, 0]) / camera.exposure_s,
        panel=_panel(stage.half_m(array), maps[:, 1], ahead, bounds, camera.blur_px),
        bounds=bounds,
        motion_px=2 * np.linalg.norm(np.diff(corners, axis=1), axis=-1).max((1, 2)),
        ahead=ahead,
        inside=np.asarray(((leds >= -0.5) & (leds <= size - 0.5)).all((1, 2))),
        pitch_px=np.sqrt(np.abs(np.linalg.det(scale))) * emitter.pitch_m,
        roll_rad=np.arctan2(scale[:, 1, 0], scale[:, 0, 0]),
    )


def _panel(half_m: float | Floats, maps: Floats, ahead: NDArray[np.bool_], bounds: Floats, blur_px: float) -> PanelView:
    maps = np.where(ahead[:, None, None], maps, np.eye(3))  # the others are not drawn
    # the pixel's box counts by its variance 1/12 here: edges have no more contrast than the background
    sigma = math.hypot(blur_px, math.sqrt(1 / 12))
    metres: Floats = (
        np.asarray(np.linalg.norm(np.linalg.inv(centre_scale(maps)), axis=-1), float) * sigma
    )  # a sigma across the panel's edges, (b, 2)
    inverse = np.asarray(np.linalg.inv(maps), float)
    inverse[:, :2] /= metres[..., None]
    reach = np.array([[-1], [1]]) * (7 * sigma + 1)
    box = np.clip(np.round(bounds + reach), -(2**31), 2**31).astype(np.int64)
    return PanelView(inverse, half_m / metres, box.reshape(-1, 4))


def windows(block: Block, camera: CameraSettings, roi: int | None) -> NDArray[np.int64]:
    """First x, first y, last x, last y of the part of the sensor to render, (b, 4)."""
    whole = np.array([0, 0, camera.width - 1, camera.height - 1])
    if roi is None:
        return np.tile(whole, (len(block.index), 1))
    low = np.full((len(block.index), 2), np.inf)
    high = -low
    for view in block.views:
        low = np.where(view.ahead[:, None], np.minimum(low, np.floor(view.bounds[:, 0])), low)
        high = np.where(view.ahead[:, None], np.maximum(high, np.ceil(view.bounds[:, 1])), high)
    none = np.isinf(low)  # no array ahead: one pixel in the corner
    edges = np.hstack([np.where(none, 0, low - roi), np.where(none, 0, high + roi)])
    return np.clip(edges, 0, np.tile(whole[2:], 2)).astype(np.int64)


def render(stage: Stage, block: Block, k: int, canvas: Canvas) -> tuple[ArrayTruth, ...]:
    """Light of frame k of a block on a window of the sensor, written into the canvas; and the truth."""
    start, middle, end = map(float, block.times_s[k])
    stage.paint(canvas.light, canvas.corner, middle, block.pose, (k, 1))
    lit = [lighting.lit(start, end) for lighting in stage.lightings]
    # far arrays first: a nearer panel hides them
    for array in sorted(range(len(lit)), key=lambda a: -block.views[a].homography[k, 2, 2]):
        view, one = block.views[array], lit[array]
        if view.ahead[k] and canvas.meets(view.panel.box[k]):
            _lay_panel(view.panel, k, stage.settings.emitter.panel_level, canvas)
            _hide(stage, array, view, k, canvas)
            if one is not None:
                _shine(stage, array, view, k, one, (start, end), canvas)
    return tuple(_truth(view, k, one) for view, one in zip(block.views, lit, strict=True))


def _lay_panel(panel: PanelView, k: int, level: float, canvas: Canvas) -> None:
    half = (float(panel.half[k, 0]), float(panel.half[k, 1]))
    left, top, right, low = map(int, panel.box[k])
    cover(canvas.light, canvas.corner, panel.inverse[k], half, (left, top, right, low), level, normal_table())


def _hide(stage: Stage, array: int, view: View, k: int, canvas: Canvas) -> None:
    """Lay what hides a part of an array over its panel; the LEDs behind it are left out of what is lit."""
    settings, place = stage.settings, stage.settings.arrays[array]
    if not place.hidden:
        return
    left, top, right, low = (np.array(place.hidden) - 0.5) * stage.lightings[array].feed.side * settings.emitter.pitch_m
    # the plane's origin moved to the middle of the part
    moved = np.array([[1.0, 0.0, 0.5 * (left + right)], [0.0, 1.0, 0.5 * (top + low)], [0.0, 0.0, 1.0]])
    half = 0.5 * np.array([right - left, low - top])
    panel = _panel(
        half, (view.homography[k] @ moved)[None], np.ones(1, bool), view.bounds[k][None], settings.camera.blur_px
    )
    _lay_panel(panel, 0, place.hidden_level, canvas)


def _shine(
    stage: Stage, array: int, view: View, k: int, lit: Lit, exposure: tuple[float, float], canvas: Canvas
) -> None:
    """Add an array's LEDs, (6): r = c integral of y(t) f(t) dt."""
    start, end = exposure
    settings = stage.settings
    level = settings.emitter.all_on * settings.arrays[array].brightness
    if view.motion_px[k] <= SMEAR_PX:
        share, late, spread = lit.moments(start, end)
        add_array(settings, view.homography[k], view.drift[k], view.eye[k], (level * share, late, spread), canvas)
        return
    lit = lit.split((end - start) * SMEAR_PX / float(view.motion_px[k]))
    times = (lit.start_s + lit.end_s) / 2
    maps, eyes = stage.maps(array, times, stage.drive.pose(times))
    for on, length, one, eye in zip(lit.on, lit.end_s - lit.start_s, maps, eyes, strict=True):
        moments = (on * (level * length / (end - start)), np.zeros_like(on), np.full_like(on, length**2 / 12))
        add_array(settings, one, view.drift[k], eye, moments, canvas)


def add_array(
    settings: ChannelSettings,
    one: Floats,
    drift: Floats,
    eye: Floats,
    moments: tuple[Floats, Floats, Floats],
    canvas: Canvas,
) -> None:
    """Add an array's LEDs about one pose to a window of the light; parameters as for `optics.add_leds`."""
    emitter, camera = settings.emitter, settings.camera
    radius = emitter.diameter_m / 2
    resolution = radius * camera.focal_px / one[2, 2] / camera.blur_px
    # steps of an eighth of an octave, so that few cubatures are made and kept
    points, rest = disc_cubature(2.0 ** (math.ceil(8 * math.log2(resolution)) / 8))
    shape = (emitter.pitch_m, radius, emitter.lobe_order)
    lens = (camera.focal_px, camera.blur_px)
    add_leds(canvas.light, canvas.corner, one, drift, eye, moments, shape, lens, points, rest, normal_table())


def _truth(view: View, k: int, lit: Lit | None) -> ArrayTruth:
    one = view.homography[k]
    depth = float(one[2, 2])
    return ArrayTruth(
        x=float(one[0, 2]) / depth,
        y=float(one[1, 2]) / depth,
        pitch_px=float(view.pitch_px[k]),
        roll_rad=float(view.roll_rad[k]),
        homography=one,
        distance_m=depth,
        visible=bool(view.ahead[k] and view.inside[k]),
        patterns=lit.patterns if lit else (),
    )
