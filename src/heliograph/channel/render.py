"""Light on the sensor in one exposure: background, panels, and LEDs along their motion."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.channel.background import Painter
from heliograph.channel.exposure import Lighting, Lit
from heliograph.channel.motion import Motion
from heliograph.channel.optics import add_leds, cover, disc_cubature, normal_table
from heliograph.channel.parts import POINT_SPREADS
from heliograph.channel.psf import PointSpread
from heliograph.channel.scene import CameraPose, centre_scale, homography, project, square
from heliograph.channel.settings import CameraSettings, ChannelSettings
from heliograph.channel.truth import ArrayTruth

SMEAR_PX = 0.25
"""Motion within an exposure up to which an LED's smear is rendered by its centroid and variance: the fourth cumulant
left out, -0.25^4 / 120, changes the peak of the reference blur by less than 1e-4; at twice the value by 16 times as
much. Faster exposures are cut into pieces that move no further."""

NEAREST_M = 0.3
"""An array whose panel is nearer than this to the camera's plane is not rendered. Chosen: its image is then far larger
than the sensor, 3500 px wide in the reference link; the value only keeps depths above 0."""

_PANEL_REACH_SIGMA = 7.0
"""Standard deviations beyond the panel's corners for which it is drawn: beyond `LIMIT_SIGMA`, where it is 0."""

_BOX_VARIANCE = 1 / 12
"""Variance of a pixel's box in px^2."""

_STEPS_PER_OCTAVE = 8
"""Steps of the resolution for which cubatures are made, rounded up, so that few are made and kept. Chosen: from 10 to
80 m there are 24; the rounding makes a cubature finer than needed by at most 9 %, by 19 % at half the value."""

_FARTHEST_PX = 2**31
"""Pixels to which the places of panels are cut, so that they fit integers; they lie far off the sensor."""


@dataclass(frozen=True)
class FilmScene:
    """Everything that stays the same during a film.

    Attributes
    ----------
    settings
        The whole channel: scene, camera, emitters, sensor and background.
    lightings
        The patterns of each array, in the order of ``settings.arrays``.
    drive
        The camera's pose at any time.
    paint
        Writes the background into a window of the light.
    """

    settings: ChannelSettings
    lightings: list[Lighting]
    drive: Motion
    paint: Painter

    def half_m(self, array: int) -> float:
        """Return half the side of an array's panel, in m.

        Parameters
        ----------
        array
            Number of the array, from 0, in the order of ``settings.arrays``.
        """
        emitter = self.settings.emitter
        return self.lightings[array].feed.side / 2 * emitter.pitch_m + emitter.panel_margin_m

    def maps(self, array: int, times_s: Floats, pose: CameraPose) -> tuple[Floats, Floats]:
        """Return homography and eye of an array, as `scene.homography` does.

        Parameters
        ----------
        array
            Number of the array, from 0, in the order of ``settings.arrays``.
        times_s
            (...) times in s.
        pose
            Poses of the camera at these times.

        Returns
        -------
        homography
            (..., 3, 3).
        eye
            (..., 3) in m.
        """
        s = self.settings
        return homography(pose, times_s, s.arrays[array], s.distance_m, s.camera)


@dataclass(frozen=True, slots=True)
class Canvas:
    """A window of the sensor.

    Attributes
    ----------
    light
        (h, w) float32 light in full scales.
    corner
        (x, y) on the sensor of ``light[0, 0]``.
    """

    light: NDArray[np.float32]
    corner: tuple[int, int]

    def meets(self, box: NDArray[np.int64]) -> bool:
        """Return whether a box on the sensor reaches into the window.

        Parameters
        ----------
        box
            (4,) first x, first y, last x, last y of its pixels on the sensor.
        """
        (x, y), (height, width) = self.corner, self.light.shape
        return bool(box[0] < x + width and box[1] < y + height and box[2] >= x and box[3] >= y)


@dataclass(frozen=True)
class PanelView:
    """An array's panel in b frames, at the middle of the exposures.

    Attributes
    ----------
    inverse
        (b, 3, 3) maps for `optics.cover`.
    half
        (b, 2) half its width and height in standard deviations of the blur.
    box
        (b, 4) first x, first y, last x, last y of the pixels that it can reach.
    """

    inverse: Floats
    half: Floats
    box: NDArray[np.int64]


@dataclass(frozen=True)
class ArrayView:
    """The view of one array in b frames.

    Attributes
    ----------
    homography
        (b, 3, 3) at the middle of the exposures.
    eye
        (b, 3) at the middle of the exposures, in m.
    drift
        (b, 3, 3) mean change of the homography a second during the exposure.
    panel
        Where the array's panel is seen, at the middle of the exposures.
    bounds
        (b, 2, 2) least and largest (x, y) in px of the panel's image during the exposure.
    motion_px
        (b,) largest motion of a corner of the panel's image during the exposure, in px.
    ahead
        (b,) bool, whether the array lies ahead of the camera and faces it.
    inside
        (b,) bool, whether all LEDs lie on the sensor.
    pitch_px
        (b,) distance between LEDs in the image, as in `ArrayTruth`.
    roll_rad
        (b,) direction of the LED rows in the image, as in `ArrayTruth`.
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
class FrameBlock:
    """Poses and views of b frames, computed together.

    Attributes
    ----------
    index
        (b,) int64 numbers of the frames.
    times_s
        (b, 3) true start, middle and end of the exposures in s.
    pose
        Poses of the camera at these times, (b, 3).
    views
        The view of each array, in the order of ``channel.arrays``.
    """

    index: NDArray[np.int64]
    times_s: Floats
    pose: CameraPose
    views: tuple[ArrayView, ...]


def frame_block(scene: FilmScene, index: NDArray[np.int64]) -> FrameBlock:
    """Compute poses and views of frames.

    Parameters
    ----------
    scene
        Everything that stays the same during the film.
    index
        (b,) int64 numbers of the frames.
    """
    camera = scene.settings.camera
    start = camera.start_s + index * camera.frame_period_s
    times = start[:, None] + camera.exposure_s * np.array([0, 0.5, 1])
    pose = scene.drive.pose(times)
    views = tuple(_array_view(scene, k, times, pose) for k in range(len(scene.lightings)))
    return FrameBlock(index, times, pose, views)


def _array_view(scene: FilmScene, array: int, times_s: Floats, pose: CameraPose) -> ArrayView:
    camera, emitter = scene.settings.camera, scene.settings.emitter
    maps, eye = scene.maps(array, times_s, pose)
    corners, depth = project(maps, square(scene.half_m(array)))
    leds, _ = project(maps[:, 1], square((scene.lightings[array].feed.side - 1) / 2 * emitter.pitch_m))
    size = np.array([camera.width, camera.height])
    scale = centre_scale(maps[:, 1])
    ahead = np.asarray((depth > NEAREST_M).all((1, 2)) & (eye[..., 2] < 0).all(1))
    bounds = np.stack([corners.min((1, 2)), corners.max((1, 2))], 1)
    return ArrayView(
        homography=maps[:, 1],
        eye=eye[:, 1],
        drift=(maps[:, 2] - maps[:, 0]) / camera.exposure_s,
        panel=_panel(scene.half_m(array), maps[:, 1], ahead, bounds, camera.blur_px),
        bounds=bounds,
        motion_px=2 * np.linalg.norm(np.diff(corners, axis=1), axis=-1).max((1, 2)),
        ahead=ahead,
        inside=np.asarray(((leds >= -0.5) & (leds <= size - 0.5)).all((1, 2))),
        pitch_px=np.sqrt(np.abs(np.linalg.det(scale))) * emitter.pitch_m,
        roll_rad=np.arctan2(scale[:, 1, 0], scale[:, 0, 0]),
    )


def _panel(half_m: float | Floats, maps: Floats, ahead: NDArray[np.bool_], bounds: Floats, blur_px: float) -> PanelView:
    maps = np.where(ahead[:, None, None], maps, np.eye(3))  # the others are not drawn
    # the pixel's box enters by its variance alone here: edges have no more contrast than the background
    sigma = math.hypot(blur_px, math.sqrt(_BOX_VARIANCE))
    metres: Floats = (
        np.asarray(np.linalg.norm(np.linalg.inv(centre_scale(maps)), axis=-1), float) * sigma
    )  # a sigma across the panel's edges in m, (b, 2)
    inverse = np.asarray(np.linalg.inv(maps), float)
    inverse[:, :2] /= metres[..., None]
    reach = np.array([[-1], [1]]) * (_PANEL_REACH_SIGMA * sigma + 1)
    box = np.clip(np.round(bounds + reach), -_FARTHEST_PX, _FARTHEST_PX).astype(np.int64)
    return PanelView(inverse, half_m / metres, box.reshape(-1, 4))


def windows(block: FrameBlock, camera: CameraSettings, roi: int | None) -> NDArray[np.int64]:
    """Return the part of the sensor to render in each frame.

    Parameters
    ----------
    block
        Poses and views of b frames.
    camera
        Settings of the camera, of which the size of the sensor is used.
    roi
        Margin about all arrays ahead in px, at least 0; None for the whole sensor.

    Returns
    -------
    (b, 4) int64: first x, first y, last x, last y on the sensor. Without an array ahead it is pixel (0, 0) alone.
    """
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


def render(scene: FilmScene, block: FrameBlock, k: int, canvas: Canvas) -> tuple[ArrayTruth, ...]:
    """Render the light of one frame on a window of the sensor.

    Parameters
    ----------
    scene
        Everything that stays the same during the film.
    block
        Poses and views of frames.
    k
        Place of the frame in the block, from 0.
    canvas
        The window; its light is written.

    Returns
    -------
    tuple of ArrayTruth
        The truth of each array.
    """
    start, middle, end = map(float, block.times_s[k])
    scene.paint(canvas.light, canvas.corner, middle, block.pose, (k, 1))
    lit = [lighting.lit(start, end) for lighting in scene.lightings]
    # far arrays first: a nearer panel hides them
    for array in sorted(range(len(lit)), key=lambda a: -block.views[a].homography[k, 2, 2]):
        view, one = block.views[array], lit[array]
        if view.ahead[k] and canvas.meets(view.panel.box[k]):
            _lay_panel(view.panel, k, scene.settings.emitter.panel_level, canvas)
            _hide(scene, array, view, k, canvas)
            if one is not None:
                _shine(scene, array, view, k, one, (start, end), canvas)
    return tuple(_truth(view, k, one) for view, one in zip(block.views, lit, strict=True))


def _lay_panel(panel: PanelView, k: int, level: float, canvas: Canvas) -> None:
    half = (float(panel.half[k, 0]), float(panel.half[k, 1]))
    left, top, right, low = map(int, panel.box[k])
    cover(canvas.light, canvas.corner, panel.inverse[k], half, (left, top, right, low), level, normal_table())


def _hide(scene: FilmScene, array: int, view: ArrayView, k: int, canvas: Canvas) -> None:
    """Lay the obstacle that hides a part of an array over its panel; `Faults.visible` leaves out the LEDs behind it."""
    settings, place = scene.settings, scene.settings.arrays[array]
    if not place.hidden:
        return
    left, top, right, low = (np.array(place.hidden) - 0.5) * scene.lightings[array].feed.side * settings.emitter.pitch_m
    # the plane's origin moves to the middle of the hidden part
    moved = np.array([[1.0, 0.0, 0.5 * (left + right)], [0.0, 1.0, 0.5 * (top + low)], [0.0, 0.0, 1.0]])
    half = 0.5 * np.array([right - left, low - top])
    panel = _panel(
        half, (view.homography[k] @ moved)[None], np.ones(1, bool), view.bounds[k][None], settings.camera.blur_px
    )
    _lay_panel(panel, 0, place.hidden_level, canvas)


def _shine(
    scene: FilmScene, array: int, view: ArrayView, k: int, lit: Lit, exposure: tuple[float, float], canvas: Canvas
) -> None:
    """Add an array's LEDs, (6): r = c integral of y(t) f(t) dt."""
    start, end = exposure
    settings = scene.settings
    level = settings.emitter.all_on * settings.arrays[array].brightness
    if view.motion_px[k] <= SMEAR_PX:
        fraction, late, spread = lit.moments(start, end)
        add_array(settings, view.homography[k], view.drift[k], view.eye[k], (level * fraction, late, spread), canvas)
        return
    lit = lit.split((end - start) * SMEAR_PX / float(view.motion_px[k]))
    times = (lit.start_s + lit.end_s) / 2
    maps, eyes = scene.maps(array, times, scene.drive.pose(times))
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
    """Add the light of an array's LEDs about one pose to a window, in place.

    Parameters
    ----------
    settings
        The channel, of which emitter and camera are used.
    one
        (3, 3) homography, as for `optics.add_leds`.
    drift
        (3, 3) change of the homography a second.
    eye
        (3,) position of the camera in the array's axes in m.
    moments
        Three (n, n) float64, as for `optics.add_leds`: light in full scales, centroid in s, variance in s^2.
    canvas
        The window; its light is changed.
    """
    emitter, camera = settings.emitter, settings.camera
    radius = emitter.diameter_m / 2
    shape = (emitter.pitch_m, radius, emitter.lobe_order)
    light, late, spread = moments
    psf: PointSpread = POINT_SPREADS[camera.psf](camera)
    for fraction, (dx, dy), sigma in zip(psf.fraction, psf.shift_px, psf.sigma_px.tolist(), strict=True):
        # the Gaussian's place beside the point moves the image: (x + dx, y + dy, 1) Z
        shift = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy], [0.0, 0.0, 1.0]])
        resolution = radius * camera.focal_px / one[2, 2] / sigma
        steps = math.ceil(_STEPS_PER_OCTAVE * math.log2(resolution))
        points, rest = disc_cubature(2.0 ** (steps / _STEPS_PER_OCTAVE))
        part, lens = (fraction * light, late, spread), (camera.focal_px, sigma)
        add_leds(
            canvas.light,
            canvas.corner,
            shift @ one,
            shift @ drift,
            eye,
            part,
            shape,
            lens,
            points,
            rest,
            normal_table(),
        )


def _truth(view: ArrayView, k: int, lit: Lit | None) -> ArrayTruth:
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
