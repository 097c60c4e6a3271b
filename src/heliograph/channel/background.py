"""The background of the arrays: flat, a drawn scene or recorded footage, moved with the camera's shake."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Gray
from heliograph.base.compiled import compiled
from heliograph.base.errors import SettingsError
from heliograph.channel.drawn_street import draw_scene
from heliograph.channel.footage import Footage
from heliograph.channel.parts import BACKGROUNDS
from heliograph.channel.scene import CameraPose
from heliograph.channel.settings import CameraSettings, ChannelSettings
from heliograph.channel.street_view import draw_street

SHAKE_MARGIN_PX = 64
"""Background kept beyond each side of the frame for the shake; further out its edge pixels are repeated. Chosen: in the
reference link the image moves by up to 19 px on a road of class B, 77 px on class D, and with the recorded trace by up
to 69 px. At half the value 2.3 % of that trace's frames show repeated pixels, at this value 0.4 %, at twice none."""

MOST_FRAMES = 400
"""Frames of footage held in memory; a longer clip is played backward from there. Chosen: 295 MB at 1024 x 512 pixels,
in proportion to the value."""

SCENE_DEPTH_M = 300.0
"""Distance of a drawn scene, which expands by depth / (depth - distance driven). Chosen as that of buildings at the end
of a street: a drive of 55 m expands it by 22 %; 58 % at half the value, 10 % at twice."""

LEAST_ZOOM = 0.05
"""Least scale from sensor to scene, reached 15 m before a scene 300 m away, where the expansion would be infinite.
Chosen; the reference drive ends at 0.82."""

STILL = ("flat", "synthetic", "street", "street-night")
"""Kinds of background that change with the camera's pose alone; others may change with time."""

_FAR_EDGE_PX = 1.001
"""Distance of the last place read from the far edge: its right and lower neighbours are within the image."""

_WHITE = 255
"""Gray level of white in images of 8 bits."""


@compiled(error_model="numpy")
def warp(
    light: NDArray[np.float32],
    corner: tuple[int, int],
    first: Gray,
    second: Gray,
    weight: float,
    affine: NDArray[np.float64],
) -> None:
    """Write a bilinearly interpolated mixture of two images into a window of the light."""
    height, width = light.shape
    last_x, last_y = first.shape[1] - _FAR_EDGE_PX, first.shape[0] - _FAR_EDGE_PX
    w = np.float32(weight)
    scale = np.float32(affine[2, 2])
    guess = width
    for i in range(height):
        j = 0
        row = light[i]
        ax, ay = affine[0, 0], affine[1, 0]
        bx = affine[0, 1] * (i + corner[1]) + affine[0, 2]
        by = affine[1, 1] * (i + corner[1]) + affine[1, 2]
        while j < width:
            x0 = int(min(max(ax * (j + corner[0]) + bx, 0.0), last_x))
            y0 = int(min(max(ay * (j + corner[0]) + by, 0.0), last_y))
            # a run of pixels whose places in the images, rounded down, are neighbours too: true if it is of the last
            run = min(width - j, 2 * guess)
            while run > 1:
                e = j + run - 1 + corner[0]
                if (
                    int(min(max(ax * e + bx, 0.0), last_x)) == x0 + run - 1
                    and int(min(max(ay * e + by, 0.0), last_y)) == y0
                ):
                    break
                run = (run + 1) // 2
            run = min(run, first.shape[1] - 1 - x0)
            guess = run
            a0, a1 = first[y0, x0 : x0 + run + 1], first[y0 + 1, x0 : x0 + run + 1]
            b0, b1 = second[y0, x0 : x0 + run + 1], second[y0 + 1, x0 : x0 + run + 1]
            for k in range(run):
                c = j + k + corner[0]
                fx = np.float32(min(max(ax * c + bx, 0.0), last_x) - (x0 + k))
                fy = np.float32(min(max(ay * c + by, 0.0), last_y) - y0)
                p = np.float32(a0[k]) + w * (np.float32(b0[k]) - np.float32(a0[k]))
                q = np.float32(a0[k + 1]) + w * (np.float32(b0[k + 1]) - np.float32(a0[k + 1]))
                r = np.float32(a1[k]) + w * (np.float32(b1[k]) - np.float32(a1[k]))
                s = np.float32(a1[k + 1]) + w * (np.float32(b1[k + 1]) - np.float32(a1[k + 1]))
                upper = p + fx * (q - p)
                row[j + k] = scale * (upper + fy * (r + fx * (s - r) - upper))
            j += run


def image_motion(
    pose: CameraPose, index: tuple[int, ...], camera: CameraSettings, size: tuple[int, int], depth_m: float
) -> NDArray[np.float64]:
    """Return the map from sensor pixels to pixels of an image of the far scene.

    It is the rotation K R K^-1 to first order about the optical axis, and the expansion depth / (depth - distance
    driven).
    """
    pitch, yaw, roll, driven = (a[index] for a in (pose.pitch_rad, pose.yaw_rad, pose.roll_rad, pose.travelled_m))
    zoom = max(1 - driven / depth_m, LEAST_ZOOM)
    turn = zoom * np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    middle = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
    shift = camera.focal_px * np.array([yaw, -pitch])
    affine = np.eye(3)
    affine[:2, :2] = turn
    affine[:2, 2] = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2]) + shift - turn @ middle
    return affine


@dataclass
class Clip:
    """Footage at the background's size, read as far as it is needed, played forward and then backward."""

    # Frames and their rate
    footage: Footage
    # (height, width) of the background in pixels
    size: tuple[int, int]
    # Frames read so far, at most `MOST_FRAMES`
    held: list[Gray] = field(default_factory=list)
    # Iterator over the frames, once reading has begun
    source: Iterator[Gray] | None = None
    # Whether all frames are read, or as many as are held
    ended: bool = False

    def _read_to(self, number: int) -> None:
        if self.source is None:
            self.source = iter(self.footage.frames())
        while len(self.held) <= number and not self.ended:
            frame = next(self.source, None) if len(self.held) < MOST_FRAMES else None
            if frame is None:
                self.ended = True
            else:
                self.held.append(cover_size(frame, self.size))
        if not self.held:
            raise SettingsError("the footage has no frames")

    def at(self, time_s: float) -> tuple[Gray, Gray, float]:
        """Return the frames before and after a time, and the weight of the second, 0 to 1."""
        place = max(time_s, 0.0) * self.footage.rate_hz
        whole = int(place)
        self._read_to(whole + 1)
        return self._mirrored(whole), self._mirrored(whole + 1), place - whole

    def _mirrored(self, number: int) -> Gray:
        if number < len(self.held):
            return self.held[number]
        period = max(2 * (len(self.held) - 1), 1)
        number %= period
        return self.held[min(number, period - number) if len(self.held) > 1 else 0]


def cover_size(frame: Gray, size: tuple[int, int]) -> Gray:
    """Scale a gray frame until it covers a size, and cut out its middle."""
    import cv2

    if frame.ndim != 2 or frame.dtype != np.uint8 or min(frame.shape) < 2:
        raise SettingsError(f"footage is gray uint8 frames (rows, columns), not {frame.shape} {frame.dtype}")
    scale = max(size[0] / frame.shape[0], size[1] / frame.shape[1])
    height, width = (max(wish, round(have * scale)) for wish, have in zip(size, frame.shape, strict=True))
    scaled = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    top, left = (height - size[0]) // 2, (width - size[1]) // 2
    return np.ascontiguousarray(scaled[top : top + size[0], left : left + size[1]])


Painter = Callable[[NDArray[np.float32], tuple[int, int], float, CameraPose, tuple[int, ...]], None]
"""Writes the background into a window of the light: (light, corner, time in s, poses, index of one pose)."""


@dataclass(frozen=True)
class Scenery:
    """What a background is made for.

    Attributes
    ----------
    settings
        The channel; settings of a part of one's own are in ``settings.own``.
    footage
        Recorded frames; None where there are none.
    rng
        Source of randomness, the same for the same seed.
    """

    settings: ChannelSettings
    footage: Footage | None
    rng: np.random.Generator

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the sensor and a margin for shake."""
        camera = self.settings.camera
        return camera.height + 2 * SHAKE_MARGIN_PX, camera.width + 2 * SHAKE_MARGIN_PX


def flat_background(scenery: Scenery) -> Painter:
    """Return the painter of an even background."""
    level = scenery.settings.background.level
    return lambda light, *_: light.fill(level)


def drawn_background(scenery: Scenery) -> Painter:
    """Return the painter of a drawn street, which moves with the camera."""
    scene, settings = draw_scene(scenery.size, scenery.rng), scenery.settings
    gain = settings.background.gain / _WHITE
    return _painter(lambda _: (scene, scene, 0.0), gain, settings.camera, scenery.size, SCENE_DEPTH_M)


def street_background(scenery: Scenery) -> Painter:
    """Return the painter of a street by day, in perspective, which moves with the camera."""
    return _street(scenery, night=False)


def night_background(scenery: Scenery) -> Painter:
    """Return the painter of a street by night, in perspective, which moves with the camera."""
    return _street(scenery, night=True)


def _street(scenery: Scenery, night: bool) -> Painter:
    scene, settings = draw_street(scenery.size, scenery.rng, night), scenery.settings
    gain = settings.background.gain / _WHITE
    return _painter(lambda _: (scene, scene, 0.0), gain, settings.camera, scenery.size, SCENE_DEPTH_M)


def footage_background(scenery: Scenery) -> Painter:
    """Return the painter of recorded frames, which move with the camera's shake."""
    if scenery.footage is None:
        raise SettingsError("background.kind = footage needs recorded frames")
    clip, settings = Clip(scenery.footage, scenery.size), scenery.settings
    gain = settings.background.gain / _WHITE
    return _painter(clip.at, gain, settings.camera, scenery.size, np.inf)  # footage holds its own expansion


def background(settings: ChannelSettings, footage: Footage | None, rng: np.random.Generator) -> Painter:
    """Return the painter of a film's background."""
    painter: Painter = BACKGROUNDS[settings.background.kind](Scenery(settings, footage, rng))
    return painter


def _painter(
    images: Callable[[float], tuple[Gray, Gray, float]],
    gain: float,
    camera: CameraSettings,
    size: tuple[int, int],
    depth_m: float,
) -> Painter:
    def paint(
        light: NDArray[np.float32], corner: tuple[int, int], time_s: float, pose: CameraPose, index: tuple[int, ...]
    ) -> None:
        affine = image_motion(pose, index, camera, size, depth_m)
        affine[2, 2] = gain
        warp(light, corner, *images(time_s), affine)

    return paint
