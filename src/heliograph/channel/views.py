"""Views of panels and LEDs in each frame, in pixels."""

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from heliograph.base.arrays import Floats
from heliograph.channel.background import Painter
from heliograph.channel.exposure import Lighting, Lit
from heliograph.channel.motion import Motion
from heliograph.channel.scene import CameraPose, centre_scale, homography, project, square
from heliograph.channel.settings import MAX_JITTER, MIN_DISTANCE_M, CameraSettings, ChannelSettings
from heliograph.channel.trajectory import array_paths
from heliograph.channel.truth import ArrayTruth


@dataclass(frozen=True)
class FilmScene:
    """Constant data of a film."""

    settings: ChannelSettings
    # Patterns of each array, in the order of ``settings.arrays``
    lightings: list[Lighting]
    # Camera pose
    drive: Motion
    # Background
    paint: Painter
    # Seed of the exposure times, at least 0
    seed: int = 0

    def half_m(self, array: int) -> float:
        """Return half the side of the panel of an array in m."""
        emitter = self.settings.emitter
        return self.lightings[array].feed.side / 2 * emitter.pitch_m + emitter.panel_margin_m

    def maps(self, array: int, times_s: Floats, pose: CameraPose) -> tuple[Floats, Floats]:
        """Return homography and camera position of an array, see `scene.homography`."""
        s = self.settings
        return homography(pose, times_s, s.arrays[array], s.distance_m, s.camera, self.paths[array])

    @cached_property
    def paths(self) -> list[CubicSpline | None]:
        """Trajectory of each array."""
        return array_paths(self.settings)


@dataclass(frozen=True)
class PanelView:
    """Panel of an array in b frames at mid-exposure."""

    # (b, 3, 3) maps for `optics.cover`
    inverse: Floats
    # (b, 2) half width and height in standard deviations of the blur
    half: Floats
    # (b, 4) first x, first y, last x, last y of the pixels
    box: NDArray[np.int64]


@dataclass(frozen=True)
class ArrayView:
    """View of an array in b frames."""

    # (b, 3, 3) at mid-exposure
    homography: Floats
    # (b, 3) camera position at mid-exposure in m
    eye: Floats
    # (b, 3, 3) mean rate of change of the homography during the exposure, per s
    drift: Floats
    panel: PanelView
    # (b, 2, 2) smallest and largest (x, y) in px of the panel image during the exposure
    bounds: Floats
    # (b,) largest motion of a panel corner during the exposure in px
    motion_px: Floats
    # (b,) bool, True if the array faces the camera
    ahead: NDArray[np.bool_]
    # (b,) bool, True if all LEDs are on the sensor
    inside: NDArray[np.bool_]
    # (b,) LED pitch in the image, as in `ArrayTruth`
    pitch_px: Floats
    # (b,) direction of the LED rows in the image, as in `ArrayTruth`
    roll_rad: Floats

    def truth(self, k: int, lit: Lit | None) -> ArrayTruth:
        """Return the truth of a frame."""
        plane = self.homography[k]
        (x, y), depth_m = (plane[:2, 2] / plane[2, 2]).tolist(), float(plane[2, 2])
        visible, patterns = bool(self.ahead[k] and self.inside[k]), lit.patterns if lit else ()
        place = x, y, float(self.pitch_px[k]), float(self.roll_rad[k]), plane, depth_m
        return ArrayTruth(*place, visible, patterns, self.eye[k], self.drift[k])


@dataclass(frozen=True)
class FrameBlock:
    """Poses and views of b frames."""

    # (b,) int64 frame numbers
    index: NDArray[np.int64]
    # (b, 3) true start, middle and end of the exposures in s, of the first row for a rolling shutter
    times_s: Floats
    # (b,) delay of each exposure relative to a uniform rate in s
    late_s: Floats
    # Camera poses at these times, (b, 3)
    pose: CameraPose
    # View of each array, in the order of ``channel.arrays``
    views: tuple[ArrayView, ...]


def frame_block(scene: FilmScene, index: NDArray[np.int64]) -> FrameBlock:
    """Compute poses and views of frames."""
    camera = scene.settings.camera
    late = np.zeros(len(index))
    if camera.uneven_s:  # a function of seed and frame number
        drawn = [np.random.default_rng([scene.seed, int(number), 1]).normal(0, camera.uneven_s) for number in index]
        late = np.clip(drawn, -MAX_JITTER / camera.fps, MAX_JITTER / camera.fps)
    start = camera.start_s + index * camera.frame_period_s + late
    times = start[:, None] + camera.exposure_s * np.array([0, 0.5, 1])
    pose = scene.drive(times)
    views = tuple(_array_view(scene, k, times, pose) for k in range(len(scene.lightings)))
    return FrameBlock(index, times, late, pose, views)


def _array_view(scene: FilmScene, array: int, times_s: Floats, pose: CameraPose) -> ArrayView:
    camera, emitter = scene.settings.camera, scene.settings.emitter
    maps, eye = scene.maps(array, times_s, pose)
    corners, depth = project(maps, square(scene.half_m(array)))
    leds, _ = project(maps[:, 1], square((scene.lightings[array].feed.side - 1) / 2 * emitter.pitch_m))
    size = np.array([camera.width, camera.height])
    scale = centre_scale(maps[:, 1])
    ahead = np.asarray((depth > MIN_DISTANCE_M).all((1, 2)) & (eye[..., 2] < 0).all(1))
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
    """Return the view of a rectangle in a block of frames."""
    maps = np.where(ahead[:, None, None], maps, np.eye(3))  # other panels are not drawn
    # an edge has low contrast: the variance of the pixel area suffices
    sigma = math.hypot(blur_px, math.sqrt(1 / 12))
    # sigma across the panel edges in m, (b, 2)
    metres: Floats = np.asarray(np.linalg.norm(np.linalg.inv(centre_scale(maps)), axis=-1), float) * sigma
    inverse = np.asarray(np.linalg.inv(maps), float)
    inverse[:, :2] /= metres[..., None]
    reach = np.array([[-1], [1]]) * (7.0 * sigma + 1)  # beyond `LIMIT_SIGMA`
    box = np.clip(np.round(bounds + reach), -(2**31), 2**31).astype(np.int64)
    return PanelView(inverse, half_m / metres, box.reshape(-1, 4))


def windows(block: FrameBlock, camera: CameraSettings, roi: int | None) -> NDArray[np.int64]:
    """Return the sensor window to render in each frame."""
    full = np.array([0, 0, camera.width - 1, camera.height - 1])
    if roi is None:
        return np.tile(full, (len(block.index), 1))
    hidden = np.array([[np.inf], [-np.inf]])
    bounds = np.array([np.where(view.ahead[:, None, None], view.bounds, hidden) for view in block.views])
    bounds = bounds.reshape(-1, len(block.index), 2, 2)
    low = np.floor(bounds[:, :, 0].min(0, initial=np.inf))
    high = np.ceil(bounds[:, :, 1].max(0, initial=-np.inf))
    none = np.isinf(low)  # no array: a pixel in the corner
    edges = np.hstack([np.where(none, 0, low - roi), np.where(none, 0, high + roi)])
    parts = np.clip(edges, 0, np.tile(full[2:], 2)).astype(np.int64)
    parts[(parts[:, :2] == 0).all(1) & (parts != full).any(1), 0] = 1
    parts[:, 2] = np.maximum(parts[:, 2], parts[:, 0])
    return parts
