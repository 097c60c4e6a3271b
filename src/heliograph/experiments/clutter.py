"""Short films of what a detector may take for an array: footage and lamps before a shaking camera."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.channel import Footage, ImuTrace, Placement, film
from heliograph.channel.settings import ChannelSettings
from heliograph.link.recordings import load_footage
from heliograph.link.settings import load_settings
from heliograph.receive import Pose
from heliograph.signal.block import Block
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

Gray = NDArray[np.uint8]
Header = Literal["m_sequence", "all_on"]

FRAMES, LEAD = 10, (2, 3)
"""Frames of a film, and frames before the header's four: the packet's end, of either phase."""

SIZE = (640, 1152)
"""Scene in pixels: the sensor and the channel's margin for the shake."""

RATE_HZ = 1000.0
LAMPS = 8
MOST_PAIRS = 32
"""Places of a clip that are used, evenly spread: each costs 1.5 MB."""

SUBSTEPS = (np.arange(8) + 0.5) / 8 / RATE_HZ
"""Instants of an exposure at which a lamp's light is looked at."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """A moment of a scene: frames, and when the camera starts within them."""

    footage: Footage
    start_s: float


Backdrop = Callable[[np.random.Generator], Stretch]
"""Draws a moment of a scene."""


@dataclass(frozen=True, slots=True)
class Film:
    """A short film: frames, the first of the header's, and where the array is (None: there is none)."""

    frames: list[Frame]
    first: int
    truth: Pose | None


def backdrops(clips: Mapping[str, Path], reach: int) -> dict[str, Backdrop]:
    """All scenes by name: `reach` frames of each clip, a drawn street at rest, one full of changing lamps."""
    scenes = {name: clip_backdrop(path, reach) for name, path in clips.items()}
    return {**scenes, "drawn scene": drawn_backdrop, "lamps": lamp_backdrop}


def clip_backdrop(path: Path, reach: int) -> Backdrop:
    """Moments between two frames of a clip's first `reach` ones; the channel fades one into the other."""
    from heliograph.channel.background import cover_size

    source = load_footage(path)
    step = max(2, -(-reach // MOST_PAIRS))
    held: dict[int, Gray] = {}
    for k, frame in enumerate(islice(source.frames(), reach)):
        if k % step < 2:
            held[k] = cover_size(frame, SIZE)
    order = [k for k in held if k % step == 0 and k + 1 in held]

    def draw(rng: np.random.Generator) -> Stretch:
        k = order[int(rng.integers(len(order)))]
        room = max(1 / source.rate_hz - FRAMES / RATE_HZ, 0.0)
        return Stretch(Footage(lambda: iter([held[k], held[k + 1]]), source.rate_hz), float(rng.uniform(0, room)))

    return draw


def drawn_backdrop(rng: np.random.Generator) -> Stretch:
    """A drawn street; only the camera moves."""
    from heliograph.channel.background import draw_scene

    still = draw_scene(SIZE, rng)
    return Stretch(Footage(lambda: iter([still, still]), RATE_HZ / FRAMES), 0.0)


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp: centre in px, (half) size in px, shape, speed in px/s, light over time in 0 to 1 by row of the sign.

    ``cells`` is the picture of a matrix sign, (rows, columns) of 0 and 1, or None for a plain disc or rectangle.
    """

    at: tuple[float, float]
    half: tuple[float, float]
    round: bool
    speed: tuple[float, float]
    light: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    cells: Gray | None = None


def lamp_backdrop(rng: np.random.Generator) -> Stretch:
    """A drawn street with lamps that move, flicker, blink and turn."""
    import cv2

    still = drawn_backdrop(rng).footage.frames()
    street = next(iter(still))
    makers = (_mains, _moving, _beacon, _pulsed, _sign)
    lamps = [makers[int(rng.integers(len(makers)))](rng) for _ in range(LAMPS)]
    images = []
    for k in range(FRAMES + 2):
        image = street.copy()
        for lamp in lamps:
            _draw(image, lamp, k / RATE_HZ)
        images.append(np.asarray(cv2.GaussianBlur(image, (0, 0), 0.5), np.uint8))
    # the channel looks at the middle of an exposure: half a frame on, so that it meets whole images
    return Stretch(Footage(lambda: iter(images), RATE_HZ), 0.5 / RATE_HZ)


def _draw(image: Gray, lamp: Lamp, time_s: float) -> None:
    """Draw a lamp as it shines on average over an exposure; its place is that of the middle."""
    import cv2

    light = lamp.light(time_s + SUBSTEPS).mean(-1)
    x, y = (a + v * (time_s + 0.5 / RATE_HZ) for a, v in zip(lamp.at, lamp.speed, strict=True))
    if lamp.cells is not None:
        _draw_sign(image, lamp, np.asarray(light))
        return
    shade, fine = int(20 + 235 * float(light)), 16  # 16ths of a pixel
    if lamp.round:
        cv2.circle(image, (round(x * fine), round(y * fine)), round(lamp.half[0] * fine), shade, -1, cv2.LINE_AA, 4)
        return
    corners = [(round((x + s * lamp.half[0]) * fine), round((y + s * lamp.half[1]) * fine)) for s in (-1, 1)]
    cv2.rectangle(image, corners[0], corners[1], shade, -1, cv2.LINE_AA, 4)


def _draw_sign(image: Gray, lamp: Lamp, light: NDArray[np.float64]) -> None:
    assert lamp.cells is not None
    size = max(1, round(2 * lamp.half[1] / lamp.cells.shape[0]))
    shades = 15 + 240 * lamp.cells * light[:, None]
    patch = np.kron(shades, np.ones((size, size))).astype(np.uint8)
    x, y = (int(np.clip(a, 0, s - n)) for a, s, n in zip(lamp.at, image.shape[::-1], patch.shape[::-1], strict=True))
    image[y : y + patch.shape[0], x : x + patch.shape[1]] = patch


def _body(rng: np.random.Generator) -> tuple[tuple[float, float], tuple[float, float], bool]:
    """Place, half sizes and roundness: as large as an array from 25 m to 80 m away."""
    half = float(rng.uniform(4, 20))
    at = (float(rng.uniform(90, SIZE[1] - 90)), float(rng.uniform(90, SIZE[0] - 90)))
    return at, (half, half * float(rng.uniform(0.6, 1.4))), bool(rng.random() < 0.5)


def _mains(rng: np.random.Generator) -> Lamp:
    """Twice the mains frequency, 30 % to 100 % deep."""
    depth, phase, hz = rng.uniform(0.3, 1), rng.uniform(0, 2 * np.pi), rng.choice([100.0, 120.0])
    return Lamp(*_body(rng), (0, 0), lambda t: 1 - depth * np.sin(np.pi * hz * t + phase) ** 2)


def _moving(rng: np.random.Generator) -> Lamp:
    """A steady lamp of a vehicle, up to 0.7 px a frame."""
    speed = (float(rng.uniform(-500, 500)), float(rng.uniform(-500, 500)))
    return Lamp(*_body(rng), speed, lambda t: np.ones_like(t))


def _beacon(rng: np.random.Generator) -> Lamp:
    """A rotating beacon, 3 turns a second, a beam of 8 degrees, about to pass by."""
    middle = rng.uniform(-0.01, 0.02)
    return Lamp(*_body(rng), (0, 0), lambda t: 0.05 + 0.95 * np.exp(-0.5 * (1080 * (t - middle) / 8) ** 2))


def _pulsed(rng: np.random.Generator) -> Lamp:
    """Pulse width modulation at 100 Hz to 1000 Hz, as tail lamps have it; 500 Hz is the header's own frequency."""
    hz, duty, phase = rng.uniform(100, 1000), rng.uniform(0.2, 0.8), rng.random()
    return Lamp(*_body(rng), (0, 0), lambda t: ((hz * t + phase) % 1 < duty).astype(float))


def _sign(rng: np.random.Generator) -> Lamp:
    """A matrix sign with a random picture, its rows lit in turn by quarters, 100 to 1000 times a second."""
    hz, phase, rows = rng.uniform(100, 1000), rng.random(), int(rng.integers(6, 13))
    cells = (rng.random((rows, int(rng.integers(6, 25)))) < 0.6).astype(np.uint8)
    turn = np.arange(rows)[:, None] % 4 / 4
    at, half, _ = _body(rng)
    return Lamp(at, half, False, (0, 0), lambda t: ((hz * t + phase + turn) % 1 < 0.25).astype(float), cells)


def shoot(
    stretch: Stretch,
    rng: np.random.Generator,
    imu: ImuTrace | None,
    distance_m: float | None = None,
    header: Header = "m_sequence",
    identity: int = 0,
    over: ChannelSettings | None = None,
) -> Film:
    """Film a moment in the reference link.

    Parameters
    ----------
    stretch
        The scene.
    rng
        Draws shake, noise, data and, unless `over` places it, where the array stands.
    imu
        Recorded motion; None: a road of class C.
    distance_m
        Of an array that shows the end of a packet, a header, and data again; None: no array.
    header, identity
        Its header.
    over
        Channel in place of the reference link's; its camera and arrays count.
    """
    base = over or load_settings("paper").channel
    start = stretch.start_s
    camera = replace(base.camera, start_s=start)
    array = Placement(x_m=0.0, y_m=0.0, start_s=start) if over else _placed(distance_m or 50.0, start, base, rng)
    settings = replace(
        base,
        distance_m=(distance_m or 50.0) + base.speed_m_s * start,
        duration_s=start + FRAMES / RATE_HZ,
        shake="imu" if imu else "road",
        road_class="C",
        imu_start_s=float(rng.uniform(0, imu.t_s[-1])) if imu else 0.0,
        background=replace(base.background, kind="footage"),
        camera=camera,
        arrays=(array,) if distance_m else (),
    )
    first = int(rng.choice(LEAD))
    lights = [_patterns(header, identity, first, rng)] if distance_m else []
    shots = list(film(settings, lights, rng, pattern_period_s=1e-3, footage=stretch.footage, imu=imu))
    truth = shots[first + 1][1].arrays[0] if distance_m else None
    pose = Pose(truth.x, truth.y, truth.pitch_px, truth.roll_rad) if truth else None
    return Film([frame for frame, _ in shots], first, pose)


def _placed(distance_m: float, start_s: float, settings: ChannelSettings, rng: np.random.Generator) -> Placement:
    """Somewhere on the sensor, 64 px from its edges."""
    camera = settings.camera
    reach = [(size / 2 - 64) * distance_m / camera.focal_px for size in (camera.width, camera.height)]
    x, y = (float(rng.uniform(-r, r)) for r in reach)
    return Placement(x_m=x, y_m=y, start_s=start_s)


def _patterns(header: Header, identity: int, first: int, rng: np.random.Generator) -> list[NDArray[np.uint8]]:
    """The last patterns of a packet of random data, then the first of it."""
    form = PacketFormat(SignalSettings(header=header))
    blocks = {
        name: [
            Block(name, identity, 0, 0, 0, rng.bytes(layer.payload_bytes)) for _ in range(layer.codewords)
        ]
        for name, layer in form.layers.items()
    }  # fmt: skip
    packet = form.patterns(identity, blocks)
    return [packet[(k - first) % len(packet)] for k in range(FRAMES)]
