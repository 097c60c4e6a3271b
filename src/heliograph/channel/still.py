"""Scenes in which nothing moves: what does not change is rendered once, and each LED's image too.

A frame is then a sum: light = light without LEDs + sum over LEDs of level times image.
"""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.channel.background import STILL
from heliograph.channel.optics import REACH_SIGMA, Spot, add_images, draw_images, normal_table, shape_of, spots
from heliograph.channel.render import Canvas, lay_panels, level_of, truth_of
from heliograph.channel.scene import centre_scale, project
from heliograph.channel.settings import ChannelSettings
from heliograph.channel.truth import ArrayTruth
from heliograph.channel.views import ArrayView, FilmScene, FrameBlock


@dataclass(frozen=True, slots=True)
class LedImages:
    """Images of an array's LEDs."""

    # (n, n, s, s) float32 light of each LED with level 1, in full scales
    light: NDArray[np.float32]
    # (n, n, 2) int64 x, y on the sensor of the first pixel of each image
    corners: NDArray[np.int64]


@dataclass(slots=True)
class StillLight:
    """Light of frames of a film, as long as nothing in sight of them moves."""

    # Everything that stays the same during the film
    scene: FilmScene
    _view: tuple[bytes, ...] = ()
    _base: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 0), np.float32))
    _images: tuple[LedImages | None, ...] = ()

    def take(self, block: FrameBlock, window: NDArray[np.int64]) -> bool:
        """Take the views of frames, and return whether nothing moves in them: `render` then does for all of them."""
        if not (_can_rest(self.scene) and _rests(block, window)):
            return False
        seen = _bytes_of(block, window)
        if seen != self._view:
            x, y, last_x, last_y = map(int, window[0])
            canvas = Canvas(np.empty((last_y - y + 1, last_x - x + 1), np.float32), (x, y))
            lay_panels(self.scene, block, 0, canvas)
            self._base, self._view = canvas.light, seen
            self._images = tuple(self._images_of(array, view, canvas) for array, view in enumerate(block.views))
        return True

    def render(self, block: FrameBlock, k: int, canvas: Canvas) -> tuple[ArrayTruth, ...]:
        """Render the light of one frame on its window, as `render.render` does."""
        start, middle, end = block.times_s[k].tolist()
        shown = [one.shown(start, end) for one in self.scene.lightings]
        np.copyto(canvas.light, self._base)
        for array, (one, images) in enumerate(zip(shown, self._images, strict=True)):
            if one is not None and images is not None:
                levels = (level_of(self.scene.settings, array, middle) * one.fraction()).astype(np.float32)
                add_images(canvas.light, canvas.corner, levels, images.light, images.corners)
        return tuple(truth_of(view, k, one) for view, one in zip(block.views, shown, strict=True))

    def _images_of(self, array: int, view: ArrayView, canvas: Canvas) -> LedImages | None:
        if not (view.ahead[0] and canvas.meets(view.panel.box[0])):
            return None
        side = self.scene.lightings[array].feed.side
        return led_images(self.scene.settings, view.homography[0], view.eye[0], side)


def _can_rest(scene: FilmScene) -> bool:
    """Whether a scene can be one of the sums that are made here."""
    settings = scene.settings
    return settings.background.kind in STILL and settings.emitter.shape != "cell" and not settings.camera.row_time_s


def _rests(block: FrameBlock, window: NDArray[np.int64]) -> bool:
    """Whether the frames of a block differ by their patterns and noise alone, and no array hides another."""
    boxes = [view.panel.box[0] for view in block.views]
    hide = any(_meet(one, other) for k, one in enumerate(boxes) for other in boxes[:k])
    moves = any(np.ptp(part, 0).any() for part in _parts(block, window))
    return not (hide or moves or any(view.drift.any() for view in block.views))


def _meet(one: NDArray[np.int64], other: NDArray[np.int64]) -> bool:
    """Whether two boxes overlap."""
    return bool((one[:2] <= other[2:]).all() and (other[:2] <= one[2:]).all())


def _bytes_of(block: FrameBlock, window: NDArray[np.int64]) -> tuple[bytes, ...]:
    """All that the light without LEDs and the images of LEDs depend on."""
    return tuple(part[0].tobytes() for part in _parts(block, window))


def _parts(block: FrameBlock, window: NDArray[np.int64]) -> list[Floats | NDArray[np.int64]]:
    """What may change from frame to frame of a block, each (b, ...)."""
    pose, views = block.pose, block.views
    poses = [pose.travelled_m, pose.heave_m, pose.pitch_rad, pose.yaw_rad, pose.roll_rad]
    return [window, *poses, *(part for view in views for part in (view.homography, view.eye, view.panel.inverse))]


def led_images(settings: ChannelSettings, one: Floats, eye: Floats, side: int) -> LedImages:
    """Return the images of an array's LEDs at rest."""
    at = (np.arange(side) - (side - 1) / 2) * settings.emitter.pitch_m
    b, a = np.meshgrid(at, at, indexing="ij")
    places, depths = project(one, np.stack([a.ravel(), b.ravel()], 1))
    # pixels a metre of the nearest LED
    scale = float(np.linalg.norm(centre_scale(one))) * (float(one[2, 2]) / float(depths.min())) ** 2
    parts = spots(settings, one)
    half = max(_reach_px(part, settings.emitter.diameter_m * scale) for part in parts)
    corners = np.rint(places).astype(np.int64).reshape(side, side, 2) - half
    images = np.zeros((side, side, 2 * half + 1, 2 * half + 1), np.float32)
    for part in parts:
        light = np.zeros_like(images)
        shape = shape_of(settings)
        draw_images(light, corners, part.homography, eye, shape, part.lens, part.points, part.rest, normal_table())
        images += np.float32(part.fraction) * light
    return _trimmed(images, corners)


def _reach_px(spot: Spot, diameter_px: float) -> int:
    """Pixels from an LED's middle to the last that it may reach, rounding of its place included."""
    shift = 0.0 if spot.shift is None else float(np.abs(spot.shift[:2, 2]).max())
    return math.ceil(REACH_SIGMA * math.hypot(spot.lens[1], diameter_px / 2) + diameter_px + shift) + 1


def _trimmed(images: NDArray[np.float32], corners: NDArray[np.int64]) -> LedImages:
    """Images without the rows and columns that are dark in all of them."""
    lit: NDArray[np.bool_] = np.any(images, axis=(0, 1))
    i, j = np.flatnonzero(lit.any(1)), np.flatnonzero(lit.any(0))
    if not i.size:
        return LedImages(images, corners)
    kept = images[:, :, i[0] : i[-1] + 1, j[0] : j[-1] + 1].copy()
    return LedImages(kept, corners + np.array([j[0], i[0]]))
