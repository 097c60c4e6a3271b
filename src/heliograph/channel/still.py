"""Fast rendering of static scenes: light = base + sum over LEDs of level times LED image."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.channel.optics import REACH_SIGMA, add_images, spots
from heliograph.channel.render import Canvas, add_array, level_of, render
from heliograph.channel.scene import centre_scale, project
from heliograph.channel.settings import ChannelSettings
from heliograph.channel.truth import ArrayTruth
from heliograph.channel.views import FilmScene, FrameBlock

LedImages = tuple[NDArray[np.float32], NDArray[np.int64]]
"""Light of each LED of an array at level 1 in full scales, (n, n, s, s), and first pixels (x, y), (n, n, 2)."""


@dataclass(slots=True)
class StillLight:
    """Renderer for static parts of a film."""

    scene: FilmScene
    _view: tuple[bytes, ...] = ()
    _base: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 0), np.float32))
    _images: Sequence[LedImages | None] = ()

    def take(self, block: FrameBlock, window: NDArray[np.int64]) -> bool:
        """Prepare a block of frames; return True if the scene is static and `render` applies."""
        settings, views = self.scene.settings, block.views
        # other backgrounds may depend on time
        is_still = settings.background.kind in ("flat", "synthetic", "street", "street-night")
        if not is_still or settings.emitter.shape == "cell" or settings.camera.row_time_s:
            return False
        inputs = [window, *vars(block.pose).values()]
        inputs += [part for view in views for part in (view.homography, view.eye, view.panel.inverse)]
        boxes = [view.panel.box[0] for view in views]
        occludes = any((a[:2] <= b[2:]).all() and (b[:2] <= a[2:]).all() for a, b in combinations(boxes, 2))
        moves = any(np.ptp(part, 0).any() for part in inputs) or any(view.drift.any() for view in views)
        if occludes or moves:
            return False
        state = tuple(part[0].tobytes() for part in inputs)
        if state != self._view:
            x, y, last_x, last_y = map(int, window[0])
            canvas = Canvas(np.empty((last_y - y + 1, last_x - x + 1), np.float32), (x, y))
            render(self.scene, block, 0, canvas, with_leds=False)
            self._base, self._view = canvas.light, state
            self._images = [
                led_images(settings, view.homography[0], view.eye[0], lighting.feed.side)
                if view.ahead[0] and canvas.meets(view.panel.box[0])
                else None
                for view, lighting in zip(views, self.scene.lightings, strict=True)
            ]
        return True

    def render(self, block: FrameBlock, k: int, canvas: Canvas) -> tuple[ArrayTruth, ...]:
        """Render the light of a frame in the window, like `render.render`."""
        start, middle, end = block.times_s[k].tolist()
        shown = [lighting.shown(start, end) for lighting in self.scene.lightings]
        np.copyto(canvas.light, self._base)
        for array, (lit, images) in enumerate(zip(shown, self._images, strict=True)):
            if lit is not None and images is not None:
                levels = level_of(self.scene.settings, array, middle) * lit.moments(start, end)[0]
                add_images(canvas.light, canvas.corner, levels.astype(np.float32), *images)
        return tuple(view.truth(k, lit) for view, lit in zip(block.views, shown, strict=True))


def led_images(settings: ChannelSettings, plane: Floats, eye: Floats, side: int) -> LedImages:
    """Return the images of the LEDs of a static array."""
    at = (np.arange(side) - (side - 1) / 2) * settings.emitter.pitch_m
    b, a = np.meshgrid(at, at, indexing="ij")
    places, depths = project(plane, np.stack([a.ravel(), b.ravel()], 1))
    # px/m at the nearest LED
    scale = float(np.linalg.norm(centre_scale(plane))) * (float(plane[2, 2]) / float(depths.min())) ** 2
    diameter_px = settings.emitter.diameter_m * scale
    reach = [
        REACH_SIGMA * math.hypot(optics[1][1], diameter_px / 2) + diameter_px + float(np.abs(shift[:2, 2]).max())
        for _, shift, optics in spots(settings, plane)
    ]
    half = math.ceil(max(reach)) + 1
    corners = np.rint(places).astype(np.int64).reshape(side, side, 2) - half
    images = np.zeros((side, side, 2 * half + 1, 2 * half + 1), np.float32)
    zero = np.zeros((side, side))
    for u, v in np.ndindex(side, side):
        level = zero.copy()
        level[u, v] = 1
        canvas = Canvas(images[u, v], (int(corners[u, v, 0]), int(corners[u, v, 1])))
        add_array(settings, plane, np.zeros((3, 3)), eye, (level, zero, zero), canvas)
    # remove the rows and columns that are dark in all images
    i, j = (np.flatnonzero(images.any(axes)) for axes in ((0, 1, 3), (0, 1, 2)))
    if not i.size:
        return images, corners
    return images[:, :, i[0] : i[-1] + 1, j[0] : j[-1] + 1].copy(), corners + np.array([j[0], i[0]])
