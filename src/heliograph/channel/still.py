"""Fast rendering of static scenes: light = base + sum over LEDs of level times LED image."""

import math
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.channel.background import STILL
from heliograph.channel.optics import REACH_SIGMA, Spot, add_images, draw_images, spots
from heliograph.channel.render import Canvas, lay_panels, level_of
from heliograph.channel.scene import centre_scale, project
from heliograph.channel.settings import ChannelSettings
from heliograph.channel.truth import ArrayTruth
from heliograph.channel.views import ArrayView, FilmScene, FrameBlock


@dataclass(frozen=True, slots=True)
class LedImages:
    """Images of the LEDs of an array."""

    # (n, n, s, s) float32 light of each LED at level 1, in full scales
    light: NDArray[np.float32]
    # (n, n, 2) int64 sensor position x, y of the first pixel of each image
    corners: NDArray[np.int64]


@dataclass(slots=True)
class StillLight:
    """Renderer for static parts of a film."""

    scene: FilmScene
    _view: tuple[bytes, ...] = ()
    _base: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 0), np.float32))
    _images: tuple[LedImages | None, ...] = ()

    def take(self, block: FrameBlock, window: NDArray[np.int64]) -> bool:
        """Prepare a block of frames; return True if the scene is static and `render` applies."""
        if not (_may_be_static(self.scene) and _is_static(block, window)):
            return False
        state = _state(block, window)
        if state != self._view:
            x, y, last_x, last_y = map(int, window[0])
            canvas = Canvas(np.empty((last_y - y + 1, last_x - x + 1), np.float32), (x, y))
            lay_panels(self.scene, block, 0, canvas)
            self._base, self._view = canvas.light, state
            self._images = tuple(self._images_of(array, view, canvas) for array, view in enumerate(block.views))
        return True

    def render(self, block: FrameBlock, k: int, canvas: Canvas) -> tuple[ArrayTruth, ...]:
        """Render the light of a frame in the window, like `render.render`."""
        start, middle, end = block.times_s[k].tolist()
        shown = [lighting.shown(start, end) for lighting in self.scene.lightings]
        np.copyto(canvas.light, self._base)
        for array, (exposed, images) in enumerate(zip(shown, self._images, strict=True)):
            if exposed is not None and images is not None:
                levels = (level_of(self.scene.settings, array, middle) * exposed.moments()[0]).astype(np.float32)
                add_images(canvas.light, canvas.corner, levels, images.light, images.corners)
        return tuple(view.truth(k, exposed) for view, exposed in zip(block.views, shown, strict=True))

    def _images_of(self, array: int, view: ArrayView, canvas: Canvas) -> LedImages | None:
        if not (view.ahead[0] and canvas.meets(view.panel.box[0])):
            return None
        side = self.scene.lightings[array].feed.side
        return led_images(self.scene.settings, view.homography[0], view.eye[0], side)


def _may_be_static(scene: FilmScene) -> bool:
    """Return True if the settings allow static rendering."""
    settings = scene.settings
    return settings.background.kind in STILL and settings.emitter.shape != "cell" and not settings.camera.row_time_s


def _is_static(block: FrameBlock, window: NDArray[np.int64]) -> bool:
    """Return True if pose and views are constant in a block and no array occludes another."""
    boxes = [view.panel.box[0] for view in block.views]
    occludes = any((a[:2] <= b[2:]).all() and (b[:2] <= a[2:]).all() for a, b in combinations(boxes, 2))
    moves = any(np.ptp(part, 0).any() for part in _parts(block, window))
    return not (occludes or moves or any(view.drift.any() for view in block.views))


def _state(block: FrameBlock, window: NDArray[np.int64]) -> tuple[bytes, ...]:
    """Return the inputs of the base and the LED images."""
    return tuple(part[0].tobytes() for part in _parts(block, window))


def _parts(block: FrameBlock, window: NDArray[np.int64]) -> list[Floats | NDArray[np.int64]]:
    """Return the variables of a block, each (b, ...)."""
    pose, views = block.pose, block.views
    poses = [pose.travelled_m, pose.heave_m, pose.pitch_rad, pose.yaw_rad, pose.roll_rad]
    return [window, *poses, *(part for view in views for part in (view.homography, view.eye, view.panel.inverse))]


def led_images(settings: ChannelSettings, plane: Floats, eye: Floats, side: int) -> LedImages:
    """Return the images of the LEDs of a static array."""
    at = (np.arange(side) - (side - 1) / 2) * settings.emitter.pitch_m
    b, a = np.meshgrid(at, at, indexing="ij")
    places, depths = project(plane, np.stack([a.ravel(), b.ravel()], 1))
    # px/m at the nearest LED
    scale = float(np.linalg.norm(centre_scale(plane))) * (float(plane[2, 2]) / float(depths.min())) ** 2
    parts = spots(settings, plane)
    half = max(_reach_px(part, settings.emitter.diameter_m * scale) for part in parts)
    corners = np.rint(places).astype(np.int64).reshape(side, side, 2) - half
    images = np.zeros((side, side, 2 * half + 1, 2 * half + 1), np.float32)
    for part in parts:
        light = np.zeros_like(images)
        draw_images(light, corners, part.homography, eye, part.optics)
        images += np.float32(part.fraction) * light
    return _trimmed(images, corners)


def _reach_px(spot: Spot, diameter_px: float) -> int:
    """Return the radius of an LED image in px, rounding of the centre included."""
    shift = 0.0 if spot.shift is None else float(np.abs(spot.shift[:2, 2]).max())
    return math.ceil(REACH_SIGMA * math.hypot(spot.optics[1][1], diameter_px / 2) + diameter_px + shift) + 1


def _trimmed(images: NDArray[np.float32], corners: NDArray[np.int64]) -> LedImages:
    """Remove the rows and columns that are dark in all images."""
    lit: NDArray[np.bool_] = np.any(images, axis=(0, 1))
    i, j = np.flatnonzero(lit.any(1)), np.flatnonzero(lit.any(0))
    if not i.size:
        return LedImages(images, corners)
    kept = images[:, :, i[0] : i[-1] + 1, j[0] : j[-1] + 1].copy()
    return LedImages(kept, corners + np.array([j[0], i[0]]))
