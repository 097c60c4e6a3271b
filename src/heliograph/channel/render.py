"""Light on the sensor during an exposure: background, panels and moving LEDs; static scenes as sums of LED images."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.channel.exposure import Lit, Moments
from heliograph.channel.optics import REACH_SIGMA, add_gaussian, add_images, add_leds, cover, normal_table, spots
from heliograph.channel.parts import POINT_SPREADS
from heliograph.channel.scene import Corner, Light, centre_scale, project
from heliograph.channel.screen import SAMPLES, add_screen, cell_light
from heliograph.channel.settings import MAX_MOTION_PX, CameraSettings, ChannelSettings, Colour
from heliograph.channel.truth import ArrayTruth
from heliograph.channel.views import ArrayView, FilmScene, FrameBlock, panel_view
from heliograph.channel.weather import extinction, scattered, seen, transmission

SMEAR_PX = 0.25
"""Largest motion for rendering motion blur by centroid and variance; longer motion is split into pieces. The neglected
fourth cumulant, -0.25^4 / 120, changes the peak of the reference blur by less than 1e-4."""


@dataclass(frozen=True, slots=True)
class Canvas:
    """Window of the sensor."""

    # (h, w) float32 light in full scales
    light: Light
    # Sensor position (x, y) of ``light[0, 0]``
    corner: Corner

    def meets(self, box: NDArray[np.int64]) -> bool:
        """Return True if a box on the sensor overlaps the window."""
        (x, y), (height, width) = self.corner, self.light.shape
        return bool(box[0] < x + width and box[1] < y + height and box[2] >= x and box[3] >= y)


def render(
    scene: FilmScene, block: FrameBlock, k: int, canvas: Canvas, with_leds: bool = True
) -> tuple[ArrayTruth, ...]:
    """Render the light of a frame in a window of the sensor."""
    start, middle, end = map(float, block.times_s[k])
    views, camera, weather = block.views, scene.settings.camera, scene.settings.weather
    scene.paint(canvas.light, canvas.corner, middle, block.pose, (k, 1))
    if extinction(weather):
        canvas.light[:] = seen(weather, canvas.light, weather.background_m)
    # with a rolling shutter, the row of the array centre determines the patterns
    late = [float(_row_times(camera, view.homography[k, 1, 2] / view.homography[k, 2, 2])) for view in views]
    shown = [lighting.shown(start + t, end + t) for lighting, t in zip(scene.lightings, late, strict=True)]
    # from far to near, the order of occlusion
    for array in sorted(range(len(views)), key=lambda a: -views[a].homography[k, 2, 2]):
        view, lit = views[array], shown[array]
        if not (view.ahead[k] and canvas.meets(view.panel.box[k])):
            continue
        _cover_panel(scene, array, view, k, canvas)
        if not with_leds:
            continue
        if scene.settings.emitter.shape == "cell":
            _add_screen(scene, array, view, k, start, canvas)
        elif camera.row_time_s:
            _add_by_rows(scene, array, view, k, (start, end), canvas)
        elif lit is not None:
            _add_leds(scene, array, view, k, lit, (start, end), canvas)
    if with_leds:
        _add_halos(scene, block, k, shown, canvas)
    return tuple(view.truth(k, lit) for view, lit in zip(views, shown, strict=True))


def _cover_panel(scene: FilmScene, array: int, view: ArrayView, k: int, canvas: Canvas) -> None:
    """Draw the panel of an array, and the obstacle in front; `Faults` excludes the LEDs behind."""
    settings, place = scene.settings, scene.settings.arrays[array]
    parts = [(view.panel, k, settings.emitter.panel_level)]
    if place.hidden:
        edges = (np.array(place.hidden) - 0.5) * scene.lightings[array].feed.side * settings.emitter.pitch_m
        low, high = edges.reshape(2, 2)
        # move the origin of the plane to the centre of the obstacle
        moved = np.eye(3)
        moved[:2, 2] = 0.5 * (low + high)
        plane, ahead = (view.homography[k] @ moved)[None], np.ones(1, bool)
        obstacle = panel_view(0.5 * (high - low), plane, ahead, view.bounds[k][None], settings.camera.blur_px)
        parts.append((obstacle, 0, place.hidden_level))
    distance_m = float(np.linalg.norm(view.eye[k]))
    for panel, row, dry in parts:
        level = seen(settings.weather, dry, distance_m)
        half_x, half_y = panel.half[row].tolist()
        left, top, right, bottom = panel.box[row].tolist()
        box = (left, top, right, bottom)
        cover(canvas.light, canvas.corner, panel.inverse[row], (half_x, half_y), box, level, normal_table())


def level_of(settings: ChannelSettings, array: int, time_s: float) -> float:
    """Return the light of an array with all LEDs on, in full scales, automatic exposure excluded."""
    return settings.emitter.all_on * settings.arrays[array].brightness * array_gain(settings, time_s)


def _add_leds(
    scene: FilmScene, array: int, view: ArrayView, k: int, lit: Lit, exposure: tuple[float, float], canvas: Canvas
) -> None:
    """Add the light of the LEDs of an array, equation (6): r = c integral of y(t) f(t) dt."""
    (start, end), settings = exposure, scene.settings
    level = level_of(settings, array, (start + end) / 2)
    if view.motion_px[k] <= SMEAR_PX:
        fraction, late, spread = lit.moments(start, end)
        moments = (level * fraction, late, spread)
        add_array(settings, view.homography[k], view.drift[k], view.eye[k], moments, canvas)
        return
    if view.motion_px[k] > MAX_MOTION_PX:
        raise SettingsError(
            f"array {array} moves {view.motion_px[k]:.4g} px in the exposure at {start:.6g} s, at most "
            f"{MAX_MOTION_PX:g}: it is too near or too fast, or the camera shakes too much; lower "
            f"channel.arrays.{array}.vx_m_s, vy_m_s or vz_m_s, channel.speed_m_s, channel.camera.exposure_s or "
            "focal_m, or end the film before by channel.duration_s"
        )
    lit = lit.split((end - start) * SMEAR_PX / float(view.motion_px[k]))
    times = (lit.start_s + lit.end_s) / 2
    maps, eyes = scene.maps(array, times, scene.drive(times))
    for on, length, plane, eye in zip(lit.on, lit.end_s - lit.start_s, maps, eyes, strict=True):
        moments = (on * (level * length / (end - start)), np.zeros_like(on), np.full_like(on, length**2 / 12))
        add_array(settings, plane, view.drift[k], eye, moments, canvas)


def _row_times(camera: CameraSettings, y: float | Floats) -> Floats:
    """Return the delay of pixel rows relative to the first row in s."""
    return np.clip(np.asarray(y, float), 0, camera.height - 1) * camera.row_time_s


def _add_by_rows(
    scene: FilmScene, array: int, view: ArrayView, k: int, exposure: tuple[float, float], canvas: Canvas
) -> None:
    """Add the LEDs of an array for a rolling shutter; the row of an LED determines the exposure."""
    lighting, pitch = scene.lightings[array], scene.settings.emitter.pitch_m
    at = (np.arange(lighting.feed.side) - (lighting.feed.side - 1) / 2) * pitch
    b, a = np.meshgrid(at, at, indexing="ij")
    points = np.stack([a, b, np.ones_like(a)], -1) @ view.homography[k].T
    late = _row_times(scene.settings.camera, np.rint(points[..., 1] / points[..., 2]))
    for t in np.unique(late):
        start, end = exposure[0] + float(t), exposure[1] + float(t)
        lit = lighting.shown(start, end)
        if lit is not None:
            moved = replace(view, homography=view.homography + float(t) * view.drift)
            _add_leds(scene, array, moved, k, replace(lit, on=lit.on * (late == t)), (start, end), canvas)


def _add_screen(scene: FilmScene, array: int, view: ArrayView, k: int, start_s: float, canvas: Canvas) -> None:
    """Add the cells of a screen row by row."""
    settings, lighting = scene.settings, scene.lightings[array]
    camera, emitter = settings.camera, settings.emitter
    size = np.array([camera.width, camera.height]) - 1
    # hand motion within a frame is below 16 px
    low, high = (np.clip(edge, 0, size) for edge in view.bounds[k] + [[-16], [16]])
    box = (int(np.floor(low[0])), int(np.floor(low[1])), int(np.ceil(high[0])), int(np.ceil(high[1])))
    rows = _row_times(camera, np.arange(box[1], box[3] + 1.0))
    # each sample of a pixel has a different time within the exposure: motion blur
    parts = (np.random.default_rng(0).permutation(SAMPLES**2) + 0.5) / SAMPLES**2 * camera.exposure_s
    n_poses = 9  # with linear interpolation, 0.5 % error of the fastest tremor
    times = start_s + np.linspace(0, rows[-1] + camera.exposure_s, n_poses)
    maps, _ = scene.maps(array, times, scene.drive(times))
    place = (rows[:, None] + parts) / (times[-1] - times[0]) * (n_poses - 1)
    before = np.minimum(place.astype(int), n_poses - 2)
    share = (place - before)[..., None, None]
    inverses = np.linalg.inv(maps)
    inverses /= inverses[:, 2:, 2:]
    cells = cell_light(lighting, emitter, start_s + rows, camera.exposure_s)
    cells *= level_of(settings, array, start_s + camera.exposure_s / 2)
    cells *= transmission(settings.weather, float(np.linalg.norm(view.eye[k])))
    inverses = (1 - share) * inverses[before] + share * inverses[before + 1]
    psf = POINT_SPREADS[camera.psf](camera)
    add_screen(canvas.light, canvas.corner, box, inverses, cells, emitter.pitch_m, psf)


def add_array(
    settings: ChannelSettings, plane: Floats, drift: Floats, eye: Floats, moments: Moments, canvas: Canvas
) -> None:
    """Add the light of the LEDs of an array at a pose to a window, in place."""
    light, late, spread = moments
    clear = transmission(settings.weather, float(np.linalg.norm(eye)))
    for fraction, shift, optics in spots(settings, plane):
        parts = (fraction * clear * light, late, spread)
        add_leds(canvas.light, canvas.corner, (shift @ plane, shift @ drift, eye), parts, optics)


def _add_halos(scene: FilmScene, block: FrameBlock, k: int, shown: Sequence[Lit | None], canvas: Canvas) -> None:
    """Add the light that fog scatters forward: a Gaussian for each array, with mean and variance of the lit LEDs."""
    settings, (start, middle, end) = scene.settings, block.times_s[k].tolist()
    camera, emitter = settings.camera, settings.emitter
    for array, (view, lit) in enumerate(zip(block.views, shown, strict=True)):
        distance_m = float(np.linalg.norm(view.eye[k]))
        share, angle = scattered(settings.weather, distance_m)
        if not share or lit is None or not view.ahead[k]:
            continue
        level = np.tensordot(lit.end_s - lit.start_s, lit.on, 1).ravel() / (end - start)
        if not level.any():
            continue
        area = float(view.pitch_px[k]) ** 2
        if emitter.shape == "disc":  # a lobe in place of the cosine of a flat cell
            cosine, depth_m = -float(view.eye[k, 2]) / distance_m, float(view.homography[k, 2, 2])
            area = cosine**emitter.lobe_order * (camera.focal_px * emitter.pitch_m / depth_m) ** 2
        at, _ = project(view.homography[k], led_grid(scene.lightings[array].feed.side, emitter.pitch_m))
        centre = level @ at / level.sum()
        x, y = np.sqrt((camera.focal_px * angle) ** 2 + level @ (at - centre) ** 2 / level.sum()).tolist()
        flux = share * area * level_of(settings, array, middle) * float(level.sum())
        add_gaussian(canvas.light, canvas.corner, (float(centre[0]), float(centre[1])), (x, y), flux, normal_table())


def led_grid(side: int, pitch_m: float) -> Floats:
    """Return the positions of LEDs row by row, (side^2, 2) in m right and down."""
    at = (np.arange(side) - (side - 1) / 2) * pitch_m
    b, a = np.meshgrid(at, at, indexing="ij")
    return np.stack([a.ravel(), b.ravel()], 1)


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
        _add_halos(self.scene, block, k, shown, canvas)
        return tuple(view.truth(k, lit) for view, lit in zip(block.views, shown, strict=True))


def led_images(settings: ChannelSettings, plane: Floats, eye: Floats, side: int) -> LedImages:
    """Return the images of the LEDs of a static array."""
    places, depths = project(plane, led_grid(side, settings.emitter.pitch_m))
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


def luma_gain(camera: CameraSettings, gamma: float, colour: Colour, time_s: float) -> float:
    """Return the factor of white balance on the light of a colour, 1 for a constant balance.

    A camera applies gains to red and blue and a power of 1 / gamma to all primaries. The luma of a film is the weighted
    sum of the primaries, the light times a gain that depends on colour and time.
    """
    if not camera.white_balance_swing:
        return 1.0
    swing = camera.white_balance_swing * math.sin(2 * math.pi * time_s / camera.white_balance_period_s)
    gains = (1 + swing, 1.0, 1 - swing)
    # Y(t) = (w_r (a_r(t) c_r)^(1/gamma) + w_g c_g^(1/gamma) + w_b (a_b(t) c_b)^(1/gamma)) L^(1/gamma)
    weights = (0.2126, 0.7152, 0.0722)  # of red, green and blue in luma (Rec. ITU-R BT.709)
    luma = sum(w * (a * c) ** (1 / gamma) for w, a, c in zip(weights, gains, colour, strict=True))
    return (luma / sum(w * c ** (1 / gamma) for w, c in zip(weights, colour, strict=True))) ** gamma


def surroundings_gain(settings: ChannelSettings, time_s: float) -> float:
    """Return the factor of white balance on the light of background and panels."""
    return luma_gain(settings.camera, settings.sensor.gamma, settings.background.colour, time_s)


def array_gain(settings: ChannelSettings, time_s: float) -> float:
    """Return the factor of white balance on the light of arrays relative to the surroundings."""
    gain = luma_gain(settings.camera, settings.sensor.gamma, settings.emitter.colour, time_s)
    return gain / surroundings_gain(settings, time_s)
