"""Light on the sensor in one exposure: background, panels, and LEDs along their motion."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.channel.exposure import Lit, Shown
from heliograph.channel.optics import add_leds, cover, normal_table, shape_of, spots
from heliograph.channel.parts import POINT_SPREADS
from heliograph.channel.settings import MOST_MOTION_PX, CameraSettings, ChannelSettings
from heliograph.channel.truth import ArrayTruth
from heliograph.channel.views import ArrayView, FilmScene, FrameBlock, PanelView, panel_view
from heliograph.channel.white_balance import array_gain

SMEAR_PX = 0.25
"""Motion within an exposure up to which an LED's smear is rendered by its centroid and variance: the fourth cumulant
left out, -0.25^4 / 120, changes the peak of the reference blur by less than 1e-4; at twice the value by 16 times as
much. Faster exposures are cut into pieces that move no further."""

_POSES = 9
"""Poses at which a screen is drawn while a rolling shutter runs; straight lines between them. Chosen: one in 6 ms of 50
ms, a sixteenth of the fastest tremor's period: right to 0.5 % of the tremor."""

_MOVED_PX = 16
"""Pixels beyond a screen's place in the first row's exposure that are drawn too. Chosen: a hand moves a phone's image
by less in the time of a frame."""


@dataclass(frozen=True, slots=True)
class Canvas:
    """A window of the sensor."""

    # (h, w) float32 light in full scales
    light: NDArray[np.float32]
    # (x, y) on the sensor of ``light[0, 0]``
    corner: tuple[int, int]

    def meets(self, box: NDArray[np.int64]) -> bool:
        """Return whether a box on the sensor reaches into the window."""
        (x, y), (height, width) = self.corner, self.light.shape
        return bool(box[0] < x + width and box[1] < y + height and box[2] >= x and box[3] >= y)


def render(scene: FilmScene, block: FrameBlock, k: int, canvas: Canvas) -> tuple[ArrayTruth, ...]:
    """Render the light of one frame on a window of the sensor."""
    start, middle, end = map(float, block.times_s[k])
    scene.paint(canvas.light, canvas.corner, middle, block.pose, (k, 1))
    cells = scene.settings.emitter.shape == "cell"
    middles = [view.homography[k, 1, 2] / view.homography[k, 2, 2] for view in block.views]
    late = [_row_times(scene.settings.camera, y) for y in middles]
    # of a rolling shutter an array's patterns are those that its middle sees
    shown = [one.shown(start + float(t), end + float(t)) for one, t in zip(scene.lightings, late, strict=True)]
    for array in _in_sight(block, k, canvas):
        view, one = block.views[array], shown[array]
        _lay(scene, array, view, k, canvas)
        if cells:
            _show(scene, array, view, k, start, canvas)
        elif scene.settings.camera.row_time_s:
            _shine_by_rows(scene, array, view, k, (start, end), canvas)
        elif one is not None:
            _shine_at_once(scene, array, view, k, one, canvas)
    return tuple(truth_of(view, k, one) for view, one in zip(block.views, shown, strict=True))


def lay_panels(scene: FilmScene, block: FrameBlock, k: int, canvas: Canvas) -> None:
    """Render the light of one frame without LEDs on a window of the sensor."""
    scene.paint(canvas.light, canvas.corner, float(block.times_s[k, 1]), block.pose, (k, 1))
    for array in _in_sight(block, k, canvas):
        _lay(scene, array, block.views[array], k, canvas)


def _in_sight(block: FrameBlock, k: int, canvas: Canvas) -> list[int]:
    """Numbers of the arrays that reach into a window, far ones first: a nearer panel hides them."""
    views = block.views
    order = sorted(range(len(views)), key=lambda a: -views[a].homography[k, 2, 2])
    return [a for a in order if views[a].ahead[k] and canvas.meets(views[a].panel.box[k])]


def _lay(scene: FilmScene, array: int, view: ArrayView, k: int, canvas: Canvas) -> None:
    """Lay an array's panel, and the obstacle before it."""
    _lay_panel(view.panel, k, scene.settings.emitter.panel_level, canvas)
    _hide(scene, array, view, k, canvas)


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
    panel = panel_view(
        half, (view.homography[k] @ moved)[None], np.ones(1, bool), view.bounds[k][None], settings.camera.blur_px
    )
    _lay_panel(panel, 0, place.hidden_level, canvas)


def _shine_at_once(scene: FilmScene, array: int, view: ArrayView, k: int, shown: Shown, canvas: Canvas) -> None:
    """Add an array's LEDs as all rows of pixels see them."""
    if view.motion_px[k] <= SMEAR_PX:
        _shine_smeared(scene, array, view, k, shown.moments(), (shown.start_s + shown.end_s) / 2, canvas)
    else:
        _shine(scene, array, view, k, shown.lit(), (shown.start_s, shown.end_s), canvas)


def _shine_smeared(
    scene: FilmScene,
    array: int,
    view: ArrayView,
    k: int,
    moments: tuple[Floats, Floats, Floats],
    middle_s: float,
    canvas: Canvas,
) -> None:
    """Add an array's LEDs by the moments of their light in an exposure about a time."""
    fraction, late, spread = moments
    moments = (level_of(scene.settings, array, middle_s) * fraction, late, spread)
    add_array(scene.settings, view.homography[k], view.drift[k], view.eye[k], moments, canvas)


def level_of(settings: ChannelSettings, array: int, time_s: float) -> float:
    """Return the light of an array with all LEDs on, in full scales, but for what the camera does to all light."""
    return settings.emitter.all_on * settings.arrays[array].brightness * array_gain(settings, time_s)


def _shine(
    scene: FilmScene, array: int, view: ArrayView, k: int, lit: Lit, exposure: tuple[float, float], canvas: Canvas
) -> None:
    """Add an array's LEDs, (6): r = c integral of y(t) f(t) dt."""
    start, end = exposure
    settings, middle_s = scene.settings, (start + end) / 2
    level = level_of(settings, array, middle_s)
    if view.motion_px[k] <= SMEAR_PX:
        _shine_smeared(scene, array, view, k, lit.moments(start, end), middle_s, canvas)
        return
    if view.motion_px[k] > MOST_MOTION_PX:
        raise SettingsError(
            f"array {array} moves {view.motion_px[k]:.4g} px in the exposure at {start:.6g} s, at most "
            f"{MOST_MOTION_PX:g}: it is too near or too fast, or the camera shakes too much; lower "
            f"channel.arrays.{array}.vx_m_s, vy_m_s or vz_m_s, channel.speed_m_s, channel.camera.exposure_s or "
            "focal_m, or end the film before by channel.duration_s"
        )
    lit = lit.split((end - start) * SMEAR_PX / float(view.motion_px[k]))
    times = (lit.start_s + lit.end_s) / 2
    maps, eyes = scene.maps(array, times, scene.drive.pose(times))
    for on, length, one, eye in zip(lit.on, lit.end_s - lit.start_s, maps, eyes, strict=True):
        moments = (on * (level * length / (end - start)), np.zeros_like(on), np.full_like(on, length**2 / 12))
        add_array(settings, one, view.drift[k], eye, moments, canvas)


def _row_times(camera: CameraSettings, y: float | Floats) -> Floats:
    """Time by which rows of pixels are exposed later than the first, in s."""
    return np.clip(np.asarray(y, float), 0, camera.height - 1) * camera.row_time_s


def _shine_by_rows(
    scene: FilmScene, array: int, view: ArrayView, k: int, exposure: tuple[float, float], canvas: Canvas
) -> None:
    """Add an array's LEDs, each lit as the rows of pixels see it that it falls on."""
    lighting, pitch = scene.lightings[array], scene.settings.emitter.pitch_m
    at = (np.arange(lighting.feed.side) - (lighting.feed.side - 1) / 2) * pitch
    b, a = np.meshgrid(at, at, indexing="ij")
    points = np.stack([a, b, np.ones_like(a)], -1) @ view.homography[k].T
    late = _row_times(scene.settings.camera, np.rint(points[..., 1] / points[..., 2]))
    for t in np.unique(late):
        shown = lighting.shown(exposure[0] + float(t), exposure[1] + float(t))
        if shown is not None:
            one = shown.lit()
            part = replace(one, on=one.on * (late == t))
            moved = replace(view, homography=view.homography + float(t) * view.drift)
            _shine(scene, array, moved, k, part, (exposure[0] + float(t), exposure[1] + float(t)), canvas)


def _show(scene: FilmScene, array: int, view: ArrayView, k: int, start_s: float, canvas: Canvas) -> None:
    """Add a screen's cells, row of pixels by row."""
    from heliograph.channel.cells import SAMPLES, add_screen, cell_light

    settings, lighting = scene.settings, scene.lightings[array]
    camera, emitter = settings.camera, settings.emitter
    size = np.array([camera.width, camera.height]) - 1
    low, high = (np.clip(edge, 0, size) for edge in view.bounds[k] + [[-_MOVED_PX], [_MOVED_PX]])
    box = (int(np.floor(low[0])), int(np.floor(low[1])), int(np.ceil(high[0])), int(np.ceil(high[1])))
    rows = _row_times(camera, np.arange(box[1], box[3] + 1.0))
    # each sample of a pixel is one part of its exposure, so that the sum is smeared by the motion
    parts = (np.random.default_rng(0).permutation(SAMPLES**2) + 0.5) / SAMPLES**2 * camera.exposure_s
    times = start_s + np.linspace(0, rows[-1] + camera.exposure_s, _POSES)
    maps, _ = scene.maps(array, times, scene.drive.pose(times))
    place = (rows[:, None] + parts) / (times[-1] - times[0]) * (_POSES - 1)
    before = np.minimum(place.astype(int), _POSES - 2)
    share = (place - before)[..., None, None]
    inverses = np.linalg.inv(maps)
    inverses /= inverses[:, 2:, 2:]
    light = cell_light(lighting, emitter, start_s + rows, camera.exposure_s)
    level = level_of(settings, array, start_s + camera.exposure_s / 2)
    add_screen(
        canvas.light,
        canvas.corner,
        box,
        (1 - share) * inverses[before] + share * inverses[before + 1],
        level * light.cells,
        emitter.pitch_m,
        POINT_SPREADS[camera.psf](camera),
    )


def add_array(
    settings: ChannelSettings,
    one: Floats,
    drift: Floats,
    eye: Floats,
    moments: tuple[Floats, Floats, Floats],
    canvas: Canvas,
) -> None:
    """Add the light of an array's LEDs about one pose to a window, in place."""
    light, late, spread = moments
    for spot in spots(settings, one):
        add_leds(
            canvas.light,
            canvas.corner,
            spot.homography,
            drift if spot.shift is None else spot.shift @ drift,
            eye,
            (spot.fraction * light, late, spread),
            shape_of(settings),
            spot.lens,
            spot.points,
            spot.rest,
            normal_table(),
        )


def truth_of(view: ArrayView, k: int, shown: Shown | None) -> ArrayTruth:
    """Return the truth of an array in a frame."""
    x, y, pitch, roll, distance, visible = view.truths[k]
    patterns = shown.patterns if shown else ()
    return ArrayTruth(x, y, pitch, roll, view.homography[k], distance, visible, patterns)
