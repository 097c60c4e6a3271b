"""What of a scene is in sight of each frame: panels, LEDs and what hides them, in pixels."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.channel.background import Painter
from heliograph.channel.exposure import Lighting
from heliograph.channel.motion import Motion
from heliograph.channel.scene import CameraPose, centre_scale, homography, project, square
from heliograph.channel.settings import NEAREST_M, CameraSettings, ChannelSettings
from heliograph.channel.transfer import LARGEST_JITTER

_FARTHEST_PX = 2**31
"""Pixels to which the places of panels are cut, so that they fit integers; they lie far off the sensor."""


@dataclass(frozen=True)
class FilmScene:
    """Everything that stays the same during a film."""

    # The whole channel: scene, camera, emitters, sensor and background
    settings: ChannelSettings
    # The patterns of each array, in the order of ``settings.arrays``
    lightings: list[Lighting]
    # The camera's pose at any time
    drive: Motion
    # Writes the background into a window of the light
    paint: Painter
    # Selects the unevenness of the exposures, at least 0
    seed: int = 0

    def half_m(self, array: int) -> float:
        """Return half the side of an array's panel, in m."""
        emitter = self.settings.emitter
        return self.lightings[array].feed.side / 2 * emitter.pitch_m + emitter.panel_margin_m

    def maps(self, array: int, times_s: Floats, pose: CameraPose) -> tuple[Floats, Floats]:
        """Return homography and eye of an array, as `scene.homography` does."""
        s = self.settings
        return homography(pose, times_s, s.arrays[array], s.distance_m, s.camera)


@dataclass(frozen=True)
class PanelView:
    """An array's panel in b frames, at the middle of the exposures."""

    # (b, 3, 3) maps for `optics.cover`
    inverse: Floats
    # (b, 2) half its width and height in standard deviations of the blur
    half: Floats
    # (b, 4) first x, first y, last x, last y of the pixels that it can reach
    box: NDArray[np.int64]


@dataclass(frozen=True)
class ArrayView:
    """The view of one array in b frames."""

    # (b, 3, 3) at the middle of the exposures
    homography: Floats
    # (b, 3) at the middle of the exposures, in m
    eye: Floats
    # (b, 3, 3) mean change of the homography a second during the exposure
    drift: Floats
    # Where the array's panel is seen, at the middle of the exposures
    panel: PanelView
    # (b, 2, 2) least and largest (x, y) in px of the panel's image during the exposure
    bounds: Floats
    # (b,) largest motion of a corner of the panel's image during the exposure, in px
    motion_px: Floats
    # (b,) bool, whether the array lies ahead of the camera and faces it
    ahead: NDArray[np.bool_]
    # (b,) bool, whether all LEDs lie on the sensor
    inside: NDArray[np.bool_]
    # (b,) distance between LEDs in the image, as in `ArrayTruth`
    pitch_px: Floats
    # (b,) direction of the LED rows in the image, as in `ArrayTruth`
    roll_rad: Floats

    @cached_property
    def truths(self) -> list[tuple[float, float, float, float, float, bool]]:
        """Centre (x, y) in px, pitch, roll, distance and visibility of each frame, as in `ArrayTruth`."""
        depth = self.homography[:, 2, 2]
        centre = self.homography[:, :2, 2] / depth[:, None]
        parts = (*centre.T, self.pitch_px, self.roll_rad, depth, self.ahead & self.inside)
        return list(zip(*(part.tolist() for part in parts), strict=True))


@dataclass(frozen=True)
class FrameBlock:
    """Poses and views of b frames, computed together."""

    # (b,) int64 numbers of the frames
    index: NDArray[np.int64]
    # (b, 3) true start, middle and end of the exposures in s, of a rolling shutter those of the first row
    times_s: Floats
    # (b,) how much later than an even one each exposure begins, in s
    late_s: Floats
    # Poses of the camera at these times, (b, 3)
    pose: CameraPose
    # The view of each array, in the order of ``channel.arrays``
    views: tuple[ArrayView, ...]


def frame_block(scene: FilmScene, index: NDArray[np.int64]) -> FrameBlock:
    """Compute poses and views of frames."""
    camera = scene.settings.camera
    late = _unevenness(camera, scene.seed, index)
    start = camera.start_s + index * camera.frame_period_s + late
    times = start[:, None] + camera.exposure_s * np.array([0, 0.5, 1])
    pose = scene.drive.pose(times)
    views = tuple(_array_view(scene, k, times, pose) for k in range(len(scene.lightings)))
    return FrameBlock(index, times, late, pose, views)


def _unevenness(camera: CameraSettings, seed: int, index: NDArray[np.int64]) -> Floats:
    """Lateness of exposures of a variable rate in s, by seed and number of the frame alone."""
    if not camera.uneven_s:
        return np.zeros(len(index))
    drawn = [np.random.default_rng([seed, int(one), 1]).normal(0, camera.uneven_s) for one in index]
    largest = LARGEST_JITTER / camera.fps
    return np.clip(drawn, -largest, largest)


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
        panel=panel_view(scene.half_m(array), maps[:, 1], ahead, bounds, camera.blur_px),
        bounds=bounds,
        motion_px=2 * np.linalg.norm(np.diff(corners, axis=1), axis=-1).max((1, 2)),
        ahead=ahead,
        inside=np.asarray(((leds >= -0.5) & (leds <= size - 0.5)).all((1, 2))),
        pitch_px=np.sqrt(np.abs(np.linalg.det(scale))) * emitter.pitch_m,
        roll_rad=np.arctan2(scale[:, 1, 0], scale[:, 0, 0]),
    )


def panel_view(
    half_m: float | Floats, maps: Floats, ahead: NDArray[np.bool_], bounds: Floats, blur_px: float
) -> PanelView:
    """Edges of a rectangle in a block of frames, and the pixels they reach."""
    maps = np.where(ahead[:, None, None], maps, np.eye(3))  # the others are not drawn
    # the pixel's box enters by its variance alone here: edges have no more contrast than the background
    # variance of a pixel's box in px^2
    sigma = math.hypot(blur_px, math.sqrt(1 / 12))
    metres: Floats = (
        np.asarray(np.linalg.norm(np.linalg.inv(centre_scale(maps)), axis=-1), float) * sigma
    )  # a sigma across the panel's edges in m, (b, 2)
    inverse = np.asarray(np.linalg.inv(maps), float)
    inverse[:, :2] /= metres[..., None]
    # standard deviations beyond the panel's corners for which it is drawn: beyond `LIMIT_SIGMA`, where it is 0
    reach = np.array([[-1], [1]]) * (7.0 * sigma + 1)
    box = np.clip(np.round(bounds + reach), -_FARTHEST_PX, _FARTHEST_PX).astype(np.int64)
    return PanelView(inverse, half_m / metres, box.reshape(-1, 4))


def windows(block: FrameBlock, camera: CameraSettings, roi: int | None) -> NDArray[np.int64]:
    """Return the part of the sensor to render in each frame."""
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
    parts = np.clip(edges, 0, np.tile(whole[2:], 2)).astype(np.int64)
    corner = (parts[:, :2] == 0).all(1) & (parts != whole).any(1)
    parts[corner, 0] = 1
    parts[:, 2] = np.maximum(parts[:, 2], parts[:, 0])
    return parts
