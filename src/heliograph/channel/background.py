"""Backgrounds: flat, a drawn street or recorded footage, subject to camera shake."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Gray
from heliograph.base.compiled import compiled
from heliograph.base.errors import SettingsError
from heliograph.channel.scene import CameraPose, Corner, Light
from heliograph.channel.settings import CameraSettings, ChannelSettings


@dataclass(frozen=True)
class Footage:
    """Gray frames for repeated reading."""

    # Returns a new iterator over (rows, columns) uint8 frames of equal size; gray levels are linear light
    frames: Callable[[], Iterator[NDArray[np.uint8]]]
    # Frames per second, above 0
    rate_hz: float

    def __post_init__(self) -> None:
        """Check the rate."""
        if not self.rate_hz > 0:
            raise ValueError(f"footage has a rate above 0, not {self.rate_hz:g}")


def draw_scene(size: tuple[int, int], rng: np.random.Generator) -> Gray:
    """Draw a street at dusk: sky, road, buildings with windows, round and rectangular lamps."""
    height, width = size
    horizon = height // 2
    sky = np.linspace(110, 60, horizon)
    road = np.linspace(30, 50, height - horizon)
    scene = np.repeat(np.concatenate([sky, road])[:, None], width, 1).astype(np.uint8)
    for left in itertools.accumulate(rng.integers(width // 24, width // 8, 64)):
        _draw_building(scene, int(left) - width // 8, horizon, rng)
    for _ in range(rng.integers(12, 24)):
        x, y = int(rng.integers(width)), int(rng.integers(height // 6, height * 5 // 6))
        w, h, shade = int(rng.integers(2, 20)), int(rng.integers(2, 16)), int(rng.integers(160, 256))
        if rng.random() < 0.5:
            cv2.circle(scene, (x, y), max(w // 2, 1), shade, -1, cv2.LINE_AA)
        else:
            cv2.rectangle(scene, (x, y), (x + w, y + h), shade, -1)
    return np.asarray(cv2.GaussianBlur(scene, (0, 0), 0.6), np.uint8)


def _draw_building(scene: Gray, left: int, horizon: int, rng: np.random.Generator) -> None:
    width, tall = int(rng.integers(30, 120)), int(rng.integers(horizon // 4, horizon))
    shade = int(rng.integers(20, 90))
    cv2.rectangle(scene, (left, horizon - tall), (left + width, horizon), shade, -1)
    for x, y in itertools.product(range(left + 5, left + width - 6, 12), range(horizon - tall + 6, horizon - 8, 16)):
        lit = int(rng.integers(120, 220)) if rng.random() < 0.3 else shade + 15
        cv2.rectangle(scene, (x, y), (x + 5, y + 8), lit, -1)


NEAR_M, FAR_M = 12.0, 320.0
"""Distance range of the drawn street."""

KERB_M = 4.6  # distance from the centre of the road to the kerb
FINER = 3  # supersampling of the drawing for smooth edges


class _Street:
    """Image of a street in perspective; positions are in m to the right, up from the road and ahead."""

    def __init__(self, size: tuple[int, int], rng: np.random.Generator, night: bool):
        self.height, self.width = (FINER * edge for edge in size)
        self.pixels = np.zeros((self.height, self.width), np.uint8)
        self.horizon = self.height // 2
        self._focal = 2.85 * self.width  # as in the reference camera
        self._rng, self._night, self._light = rng, night, 0.16 if night else 1.0

    def _fill(self, points: list[tuple[float, float, float]], level: float) -> None:
        cv2.fillConvexPoly(self.pixels, self._project(points), float(np.clip(level, 0, 255)), cv2.LINE_AA)

    def _fill_front(self, left: float, right: float, low: float, high: float, at: float, level: float) -> None:
        """Fill a rectangle that faces the camera."""
        self._fill([(left, low, at), (right, low, at), (right, high, at), (left, high, at)], level)

    def _fill_ground(self, left: float, right: float, near: float, far: float, level: float) -> None:
        self._fill([(left, 0, near), (right, 0, near), (right, 0, far), (left, 0, far)], level)

    def _fill_wall(self, x: float, low: float, high: float, near: float, far: float, level: float) -> None:
        """Fill a rectangle along the street."""
        self._fill([(x, low, near), (x, high, near), (x, high, far), (x, low, far)], level)

    def _disc(self, at: tuple[float, float, float], radius_m: float, level: float) -> None:
        (x, y), radius = self._project([at])[0], max(1, round(radius_m * self._focal / at[2]))
        cv2.circle(self.pixels, (int(x), int(y)), radius, float(level), -1, cv2.LINE_AA)

    def _project(self, points: list[tuple[float, float, float]]) -> NDArray[np.int32]:
        """Return pixel positions within the range of OpenCV."""
        corners = np.array(points, float)
        scale = self._focal / corners[:, 2]
        height_m = 1.3  # of the camera
        x, y = self.width / 2 + corners[:, 0] * scale, self.horizon - (corners[:, 1] - height_m) * scale
        return np.clip(np.stack([x, y], 1), -30_000, 30_000).round().astype(np.int32)

    def draw_ground(self) -> None:
        self.pixels[self.horizon :] = round(120 * self._light)
        self._fill_ground(-KERB_M, KERB_M, 5, FAR_M, 72 * self._light)
        for side in (-1, 1):
            self._fill_ground(side * (KERB_M - 0.5), side * (KERB_M - 0.35), 5, FAR_M, 190 * self._light)
        for at in np.arange(14.0, FAR_M, 9.0):
            self._fill_ground(-0.07, 0.07, at, at + 4, 205 * self._light)
        for x in np.arange(-4.0, 3.6, 1.0):
            self._fill_ground(x, x + 0.5, 38, 42, 210 * self._light)

    def draw_house(self, side: int, near: float, far: float) -> None:
        """Draw a front along the street with rows of windows, and the gable towards the camera."""
        rng = self._rng
        x, floors = side * (8.0 + float(rng.uniform(0, 0.8))), int(rng.integers(2, 6))
        top, shade = 3.1 * floors + 1.0, float(rng.uniform(70, 175))
        haze = 0.35 * near / FAR_M
        wall = (shade * (1 - haze) + 190 * haze) * self._light
        self._fill_wall(x, 0, top, near, far, wall)
        self._fill_front(x, x + side * 40, 0, top, near, 0.8 * wall)
        self._fill_wall(x, top, top + 0.35, near, far, 0.55 * wall)
        for floor in range(floors):
            low = 3.1 * floor + 1.0
            for at in np.arange(near + 1.2, far - 1.6, 2.6):
                lit = self._night and rng.random() < 0.3
                level = float(rng.uniform(130, 230)) if lit else (0.5 if rng.random() < 0.8 else 1.35) * wall
                self._fill_wall(x, low, low + 1.5, at, at + 1.2, level)

    def draw_tree(self, side: int, at: float) -> None:
        x, rng, light = side * (KERB_M + 1.2), self._rng, self._light
        self._fill([(x - 0.12, 0, at), (x + 0.12, 0, at), (x + 0.08, 2.6, at), (x - 0.08, 2.6, at)], 45 * light)
        for _ in range(14):
            place = x + float(rng.normal(0, 0.7)), 3.6 + float(rng.normal(0, 0.7)), at
            self._disc(place, float(rng.uniform(0.4, 0.8)), float(rng.uniform(45, 85)) * light)

    def draw_car(self, side: int, at: float) -> None:
        """Draw a parked car from behind."""
        light = self._light
        middle, shade = side * (KERB_M - 1.15), float(self._rng.choice([40, 90, 140, 205])) * light
        left, right = middle - 0.85, middle + 0.85
        self._fill_front(left, right, 0.05, 0.2, at, 15 * light)
        self._fill_front(left, right, 0.2, 0.9, at, shade)
        glass = (40 if shade > 60 * light else 95) * light
        for low, high, bottom, top, level in ((0.1, 0.3, 0.9, 1.45, shade), (0.22, 0.35, 0.95, 1.38, glass)):
            corners = [(left + low, bottom), (right - low, bottom), (right - high, top), (left + high, top)]
            self._fill([(x, y, at) for x, y in corners], level)
        for x in (left + 0.18, right - 0.18):
            self._disc((x, 0.75, at), 0.09, 210 if self._night and self._rng.random() < 0.4 else 110 * light)

    def draw_lamp(self, side: int, at: float) -> None:
        x, light = side * (KERB_M + 0.5), self._light
        end = x - side * 1.4
        self._fill([(x - 0.06, 0, at), (x + 0.06, 0, at), (x + 0.05, 6.4, at), (x - 0.05, 6.4, at)], 55 * light)
        self._fill([(x, 6.35, at), (end, 6.45, at), (end, 6.55, at), (x, 6.45, at)], 55 * light)
        self._fill_front(end - 0.3, end + 0.3, 6.35, 6.5, at, 255 if self._night else 70)


def draw_street(size: tuple[int, int], rng: np.random.Generator, night: bool = False) -> Gray:
    """Draw a straight street as (height, width) uint8: sky, houses, trees, lamps, parked cars, markings."""
    street = _Street(size, rng, night)
    sky = np.linspace(*((5, 22) if night else (150, 225)), street.horizon)
    street.pixels[: street.horizon] = sky[:, None].astype(np.uint8)
    street.draw_ground()
    for side, lots in [(side, list(_lots(rng))) for side in (-1, 1)]:
        for far, near in reversed(lots):
            street.draw_house(side, near, far)
    for at in reversed(list(np.arange(26.0, FAR_M, 22.0))):
        for side in (-1, 1):
            if rng.random() < 0.55:
                street.draw_tree(side, at + 6 * rng.random())
            if rng.random() < 0.5:
                street.draw_car(side, at + 8 * rng.random())
            street.draw_lamp(side, at)
    drawn = cv2.GaussianBlur(street.pixels, (0, 0), 0.5 * FINER)
    if night:
        glow = cv2.GaussianBlur(np.where(drawn > 150, drawn, 0).astype(np.uint8), (0, 0), 7.0 * FINER)
        drawn = cv2.add(drawn, cv2.convertScaleAbs(glow, alpha=0.8))
    return np.asarray(cv2.resize(drawn, (size[1], size[0]), interpolation=cv2.INTER_AREA), np.uint8)


def _lots(rng: np.random.Generator) -> Iterator[tuple[float, float]]:
    """Yield the far and near end of lots along the street, from near to far."""
    near = NEAR_M
    while near < FAR_M:
        far = near + float(rng.uniform(14.0, 30.0))
        yield min(far, FAR_M), near
        near = far


@compiled()
def warp(light: Light, corner: Corner, image: NDArray[np.float32], affine: NDArray[np.float64]) -> None:
    """Write a bilinear interpolation of an image into a window of the light."""
    width, pixels = light.shape[1], image.ravel()
    last_x, last_y = image.shape[1] - 1.001, image.shape[0] - 1.001  # the right and lower neighbours exist
    scale, right, below = np.float32(affine[2, 2]), np.uint64(1), np.uint64(image.shape[1])
    place, fx, fy = np.empty(width, np.uint64), np.empty(width, np.float32), np.empty(width, np.float32)
    for i in range(light.shape[0]):
        row = light[i]
        bx = affine[0, 1] * (i + corner[1]) + affine[0, 2]
        by = affine[1, 1] * (i + corner[1]) + affine[1, 2]
        for j in range(width):
            x = min(max(affine[0, 0] * (j + corner[0]) + bx, 0.0), last_x)
            y = min(max(affine[1, 0] * (j + corner[0]) + by, 0.0), last_y)
            place[j] = int(y) * image.shape[1] + int(x)
            fx[j], fy[j] = np.float32(x - int(x)), np.float32(y - int(y))
        for j in range(width):
            k = place[j]
            upper = pixels[k] + fx[j] * (pixels[k + right] - pixels[k])
            lower = pixels[k + below] + fx[j] * (pixels[k + below + right] - pixels[k + below])
            row[j] = scale * (upper + fy[j] * (lower - upper))


def image_motion(
    pose: CameraPose, index: tuple[int, ...], camera: CameraSettings, size: tuple[int, int], depth_m: float
) -> NDArray[np.float64]:
    """Return the map from sensor pixels to scene pixels: K R K^-1 to first order, and the expansion."""
    pitch, yaw, roll, driven = (a[index] for a in (pose.pitch_rad, pose.yaw_rad, pose.roll_rad, pose.travelled_m))
    zoom = max(1 - driven / depth_m, 0.05)  # bounds the expansion near the scene
    turn = zoom * np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    centre = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
    shift = camera.focal_px * np.array([yaw + pose.right_m[index] / depth_m, -pitch])
    affine = np.eye(3)
    affine[:2, :2] = turn
    affine[:2, 2] = np.array([(size[1] - 1) / 2, (size[0] - 1) / 2]) + shift - turn @ centre
    return affine


class Clip:
    """Footage at the background size, read on demand, played forward and then backward."""

    def __init__(self, footage: Footage, size: tuple[int, int], max_frames: int = 400):
        self._rate_hz = footage.rate_hz
        # 400 frames of 1024 x 512 pixels take 295 MB
        self._source = (cover_size(frame, size) for frame in itertools.islice(footage.frames(), max_frames))
        self._frames: list[Gray] = []

    def at(self, time_s: float) -> NDArray[np.float32]:
        """Return the frame at a time, interpolated between the frames before and after."""
        place = max(time_s, 0.0) * self._rate_hz
        number = int(place)
        self._frames += itertools.islice(self._source, max(0, number + 2 - len(self._frames)))
        if not self._frames:
            raise SettingsError("the footage has no frames")
        period = max(2 * (len(self._frames) - 1), 1)
        first, second = (self._frames[min(n % period, period - n % period)] for n in (number, number + 1))
        # the difference of uint8 levels needs a sign
        return first + np.float32(place - number) * (second.astype(np.float32) - first)


def cover_size(frame: Gray, size: tuple[int, int]) -> Gray:
    """Scale a gray frame to cover a size, and crop the centre."""
    if frame.ndim != 2 or frame.dtype != np.uint8 or min(frame.shape) < 2:
        raise SettingsError(f"footage is gray uint8 frames (rows, columns), not {frame.shape} {frame.dtype}")
    scale = max(size[0] / frame.shape[0], size[1] / frame.shape[1])
    height, width = (max(wanted, round(edge * scale)) for wanted, edge in zip(size, frame.shape, strict=True))
    scaled = cv2.resize(frame, (width, height), interpolation=cv2.INTER_AREA if scale < 1 else cv2.INTER_CUBIC)
    top, left = (height - size[0]) // 2, (width - size[1]) // 2
    return np.ascontiguousarray(scaled[top : top + size[0], left : left + size[1]])


Painter = Callable[[Light, Corner, float, CameraPose, tuple[int, ...]], None]
"""Writes the background into a window of the light: (light, corner, time in s, poses, index of the pose)."""


@dataclass(frozen=True)
class Scenery:
    """Input for constructing a background.

    Attributes
    ----------
    settings
        Channel settings; ``settings.custom`` has the settings of registered parts.
    footage
        Recorded frames, if any.
    rng
        Random generator for the scene.
    """

    settings: ChannelSettings
    footage: Footage | None
    rng: np.random.Generator

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of the sensor with a margin of 64 px for shake; the edge pixels repeat further out."""
        return self.settings.camera.height + 128, self.settings.camera.width + 128


def flat_background(scenery: Scenery) -> Painter:
    """Return the painter of a uniform background."""
    level = scenery.settings.background.level
    return lambda light, *_: light.fill(level)


def synthetic_background(scenery: Scenery) -> Painter:
    """Return the painter of a scene with many lamps."""
    return _still_painter(scenery, draw_scene(scenery.size, scenery.rng))


def street_background(scenery: Scenery) -> Painter:
    """Return the painter of a street by day."""
    return _still_painter(scenery, draw_street(scenery.size, scenery.rng))


def street_night_background(scenery: Scenery) -> Painter:
    """Return the painter of a street at night."""
    return _still_painter(scenery, draw_street(scenery.size, scenery.rng, night=True))


def footage_background(scenery: Scenery) -> Painter:
    """Return the painter of recorded frames."""
    if scenery.footage is None:
        raise SettingsError("background.kind = footage needs recorded frames: pass footage, or choose another kind")
    # footage contains the expansion of the drive
    return _painter(scenery, Clip(scenery.footage, scenery.size).at, np.inf)


def _still_painter(scenery: Scenery, scene: Gray) -> Painter:
    """Return the painter of a drawn scene at a distance of 300 m."""
    image = scene.astype(np.float32)
    return _painter(scenery, lambda _: image, 300.0)


def _painter(scenery: Scenery, image_at: Callable[[float], NDArray[np.float32]], depth_m: float) -> Painter:
    camera, size, gain = scenery.settings.camera, scenery.size, scenery.settings.background.gain / 255

    def paint(light: Light, corner: Corner, time_s: float, pose: CameraPose, index: tuple[int, ...]) -> None:
        affine = image_motion(pose, index, camera, size, depth_m)
        affine[2, 2] = gain
        warp(light, corner, image_at(time_s), affine)

    return paint
