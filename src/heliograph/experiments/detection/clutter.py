"""Short films of clutter that resembles an array: drawn streets, footage and lamps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats, Gray
from heliograph.base.frames import Frame
from heliograph.channel.background import Footage, cover_size, draw_scene
from heliograph.channel.camera import film
from heliograph.channel.motion import ImuTrace
from heliograph.channel.settings import ChannelSettings, Placement
from heliograph.link.settings import load_settings
from heliograph.link.simulate import load_footage
from heliograph.receive.geometry.pose import Pose
from heliograph.signal.block import Block
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

FRAMES = 10  # frames of a film
SIZE = (640, 1152)  # scene in pixels: the sensor and the margin for the shake

RATE_HZ = 1000.0

Moment = tuple[Footage, float]  # footage of a scene, and the start of the film in the footage in s

Backdrop = Callable[[np.random.Generator], Moment]  # random moment of a scene

HeaderKind = Literal["m_sequence", "all_on"]

LAMPS = "lamps"  # scene full of lamps


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Scenes and motion of the films of an experiment."""

    scenes: Mapping[str, Backdrop]
    # Recorded motion; None: a road of class C
    imu: ImuTrace | None
    seed: int


def backdrops(clips: Mapping[str, Path], reach: int) -> dict[str, Backdrop]:
    """All scenes by name: the first frames of clips, a drawn street, and a street full of lamps."""
    scenes: dict[str, Backdrop] = {name: partial(clip_backdrop, path, reach) for name, path in clips.items()}
    return {**scenes, "drawn scene": drawn_backdrop, LAMPS: lamp_backdrop}


def drawn_backdrop(rng: np.random.Generator) -> Moment:
    """Drawn street with a moving camera."""
    street = draw_scene(SIZE, rng)
    return Footage(lambda: iter([street, street]), RATE_HZ / FRAMES), 0.0


def clip_backdrop(path: Path, reach: int, rng: np.random.Generator) -> Moment:
    """Moment between two successive frames of a clip, with a cross-fade of the channel."""
    rate_hz, pairs = _clip_pairs(path, reach)
    pair = pairs[int(rng.integers(len(pairs)))]
    room = max(1 / rate_hz - FRAMES / RATE_HZ, 0.0)
    return Footage(lambda: iter(pair), rate_hz), float(rng.uniform(0, room))


@lru_cache(maxsize=8)
def _clip_pairs(path: Path, reach: int) -> tuple[float, list[tuple[Gray, Gray]]]:
    """Frame rate of a clip, and up to 32 pairs of successive frames; a pair takes 1.5 MB."""
    source = load_footage(path)
    step = max(2, -(-reach // 32))
    held: dict[int, Gray] = {}
    for k, frame in enumerate(islice(source.frames(), reach)):
        if k % step < 2:
            held[k] = cover_size(frame, SIZE)
    return source.rate_hz, [(held[k], held[k + 1]) for k in held if k % step == 0 and k + 1 in held]


Lamp = Callable[[Gray, float], None]
"""Draw a lamp into an image at a time in s: the mean light over an exposure, at the position in the middle."""

Light = Callable[[Floats], Floats]  # light 0 to 1 at times in s; (rows, times) for a matrix sign


def lamp_backdrop(rng: np.random.Generator) -> Moment:
    """Drawn street with lamps that move, flicker, blink and turn."""
    street = next(iter(drawn_backdrop(rng)[0].frames()))
    makers = (_mains, _moving, _beacon, _pulsed, _sign)
    lamps = [makers[int(rng.integers(len(makers)))](rng) for _ in range(8)]
    images = []
    for k in range(FRAMES + 2):
        image = street.copy()
        for draw in lamps:
            draw(image, k / RATE_HZ)
        images.append(np.asarray(cv2.GaussianBlur(image, (0, 0), 0.5), np.uint8))
    # the channel samples the footage in the middle of an exposure; half a frame later it gets unmixed images
    return Footage(lambda: iter(images), RATE_HZ), 0.5 / RATE_HZ


def _mean_light(light: Light, time_s: float) -> Floats:
    return np.asarray(light(time_s + (np.arange(8) + 0.5) / 8 / RATE_HZ).mean(-1))


def _body(rng: np.random.Generator) -> tuple[Floats, Floats, bool]:
    """Centre and half sizes (x, y) in px, and roundness, with the size of an array from 25 m to 80 m away."""
    half = float(rng.uniform(4, 20))
    centre = np.array([rng.uniform(90, SIZE[1] - 90), rng.uniform(90, SIZE[0] - 90)])
    return centre, np.array([half, half * rng.uniform(0.6, 1.4)]), bool(rng.random() < 0.5)


def _lamp(rng: np.random.Generator, light: Light, speed: Sequence[float] = (0.0, 0.0)) -> Lamp:
    """Disc or rectangle with a speed (x, y) in px/s."""
    start, half, is_round = _body(rng)

    def draw(image: Gray, time_s: float) -> None:
        centre = start + np.array(speed) * (time_s + 0.5 / RATE_HZ)
        # in 16ths of a pixel
        middle, size, low, high = (
            np.rint(16 * place).astype(int).tolist() for place in (centre, half, centre - half, centre + half)
        )
        shade = int(20 + 235 * float(_mean_light(light, time_s)))
        if is_round:
            cv2.circle(image, middle, size[0], shade, -1, cv2.LINE_AA, 4)
        else:
            cv2.rectangle(image, low, high, shade, -1, cv2.LINE_AA, 4)

    return draw


def _mains(rng: np.random.Generator) -> Lamp:
    """Lamp at twice the mains frequency, with a depth of 30 % to 100 %."""
    depth, phase, hz = rng.uniform(0.3, 1), rng.uniform(0, 2 * np.pi), rng.choice([100.0, 120.0])
    return _lamp(rng, lambda t: 1 - depth * np.sin(np.pi * hz * t + phase) ** 2)


def _moving(rng: np.random.Generator) -> Lamp:
    """Steady lamp of a vehicle, up to 0.7 px per frame."""
    return _lamp(rng, np.ones_like, (rng.uniform(-500, 500), rng.uniform(-500, 500)))


def _beacon(rng: np.random.Generator) -> Lamp:
    """Rotating beacon, 3 turns a second, a beam of 8 degrees, near its passage."""
    middle = rng.uniform(-0.01, 0.02)
    return _lamp(rng, lambda t: 0.05 + 0.95 * np.exp(-0.5 * (1080 * (t - middle) / 8) ** 2))


def _pulsed(rng: np.random.Generator) -> Lamp:
    """Tail lamp with pulse width modulation at 100 Hz to 1000 Hz; the header has 500 Hz."""
    hz, duty, phase = rng.uniform(100, 1000), rng.uniform(0.2, 0.8), rng.random()
    return _lamp(rng, lambda t: ((hz * t + phase) % 1 < duty).astype(float))


def _sign(rng: np.random.Generator) -> Lamp:
    """Matrix sign with a random picture, with a quarter of the rows lit in turn, 100 to 1000 times a second."""
    hz, phase, rows = rng.uniform(100, 1000), rng.random(), int(rng.integers(6, 13))
    picture = (rng.random((rows, int(rng.integers(6, 25)))) < 0.6).astype(np.uint8)
    turn = np.arange(rows)[:, None] % 4 / 4
    centre, half, _ = _body(rng)
    size = max(1, round(2 * half[1] / rows))

    def draw(image: Gray, time_s: float) -> None:
        light = _mean_light(lambda t: ((hz * t + phase + turn) % 1 < 0.25).astype(float), time_s)
        patch = np.kron(15 + 240 * picture * light[:, None], np.ones((size, size))).astype(np.uint8)
        height, width = patch.shape
        x, y = (int(np.clip(centre[0], 0, SIZE[1] - width)), int(np.clip(centre[1], 0, SIZE[0] - height)))
        image[y : y + height, x : x + width] = patch

    return draw


@dataclass(frozen=True, slots=True)
class ClutterFilm:
    """Short film."""

    # Frames, beginning before the header
    frames: list[Frame]
    # Number of the frame in which the first header begins, or would begin
    first: int
    # Pose of each array in the second frame of its header
    truths: tuple[Pose, ...]


def film_moment(
    moment: Moment,
    rng: np.random.Generator,
    imu: ImuTrace | None,
    distance_m: float | None = None,
    header: HeaderKind = "m_sequence",
    identities: Sequence[int] = (0,),
    channel: ChannelSettings | None = None,
) -> ClutterFilm:
    """Film a moment in the reference link, or in `channel` with its arrays; with no array if no distance is given."""
    base = channel or load_settings("paper").channel
    (footage, start), z = moment, distance_m or 50.0
    places = channel.arrays if channel else (_random_placement(z, base, rng),)
    settings = replace(
        base,
        distance_m=z + base.speed_m_s * start,
        duration_s=start + FRAMES / RATE_HZ,
        shake="imu" if imu else "road",
        road_class="C",
        imu_start_s=float(rng.uniform(0, imu.t_s[-1])) if imu else 0.0,
        background=replace(base.background, kind="footage"),
        camera=replace(base.camera, start_s=start),
        arrays=tuple(replace(place, start_s=start) for place in places) if distance_m else (),
    )
    firsts, patterns = [], []
    for identity in identities:
        # the header begins in either phase of a pair
        firsts.append(int(rng.choice((2, 3))))
        if distance_m:
            patterns.append(_patterns(header, identity, firsts[-1], rng))
    shots = list(film(settings, patterns, rng, pattern_period_s=1e-3, footage=footage, imu=imu))
    truths = [shots[first + 1][1].arrays[k] for k, first in enumerate(firsts)] if distance_m else []
    poses = tuple(Pose(t.x, t.y, t.pitch_px, t.roll_rad) for t in truths)
    return ClutterFilm([frame for frame, _ in shots], firsts[0], poses)


def _random_placement(distance_m: float, channel: ChannelSettings, rng: np.random.Generator) -> Placement:
    """Random place on the sensor, 64 px from its edges."""
    camera = channel.camera
    reach = [(size / 2 - 64) * distance_m / camera.focal_px for size in (camera.width, camera.height)]
    x, y = (float(rng.uniform(-r, r)) for r in reach)
    return Placement(x_m=x, y_m=y)


def _patterns(header: HeaderKind, identity: int, first: int, rng: np.random.Generator) -> list[NDArray[np.uint8]]:
    """The last patterns of a packet of random data, followed by the first patterns."""
    form = PacketFormat(SignalSettings(header=header))
    blocks = {
        name: [Block(name, identity, 0, 0, 0, rng.bytes(layer.payload_bytes)) for _ in range(layer.codewords)]
        for name, layer in form.layers.items()
    }
    packet = form.patterns(identity, blocks)
    return [packet[(k - first) % len(packet)] for k in range(FRAMES)]
