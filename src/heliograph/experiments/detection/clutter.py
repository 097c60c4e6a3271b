"""Short films of clutter that a detector may take for an array: drawn streets, footage and lamps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Literal, Self

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Gray
from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.channel import Footage, ImuTrace, Placement, film
from heliograph.channel.settings import ChannelSettings
from heliograph.link.settings import load_settings
from heliograph.link.simulate import load_footage
from heliograph.receive import Pose
from heliograph.signal.block import Block
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

FRAMES = 10
"""Frames of a film."""

SIZE = (640, 1152)
"""Scene in pixels: the sensor and the channel's margin for the shake."""

RATE_HZ = 1000.0
LAMPS = 8
SUBSTEPS = (np.arange(8) + 0.5) / 8 / RATE_HZ
"""Instants of an exposure in s at which a lamp's light is taken."""


@dataclass(frozen=True, slots=True)
class Moment:
    """A moment of a scene."""

    # The scene over time
    footage: Footage
    # When the camera starts in it, in s
    start_s: float


Backdrop = Callable[[np.random.Generator], Moment]
"""Draws a moment of a scene."""


def drawn_backdrop(rng: np.random.Generator) -> Moment:
    """A drawn street; only the camera moves."""
    from heliograph.channel.background import draw_scene

    street = draw_scene(SIZE, rng)
    return Moment(Footage(lambda: iter([street, street]), RATE_HZ / FRAMES), 0.0)


@dataclass(frozen=True, slots=True)
class Lamp:
    """A lamp."""

    # at, half: its centre and half its sizes (x, y) in px
    at: tuple[float, float]
    half: tuple[float, float]
    # Whether it is a disc; else a rectangle
    round: bool
    # (x, y) in px/s
    speed: tuple[float, float]
    # Takes times in s, gives the light at each, 0 to 1; of a matrix sign (rows, times)
    light: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    # Picture of a matrix sign, (rows, columns) of 0 and 1; None for a plain lamp
    picture: Gray | None = None


def lamp_backdrop(rng: np.random.Generator) -> Moment:
    """A drawn street with lamps that move, flicker, blink and turn."""
    import cv2

    street = next(iter(drawn_backdrop(rng).footage.frames()))
    makers = (_mains, _moving, _beacon, _pulsed, _sign)
    lamps = [makers[int(rng.integers(len(makers)))](rng) for _ in range(LAMPS)]
    images = []
    for k in range(FRAMES + 2):
        image = street.copy()
        for lamp in lamps:
            _draw(image, lamp, k / RATE_HZ)
        images.append(np.asarray(cv2.GaussianBlur(image, (0, 0), 0.5), np.uint8))
    # the channel takes the footage at the middle of an exposure: half a frame on, so that it gets whole images
    return Moment(Footage(lambda: iter(images), RATE_HZ), 0.5 / RATE_HZ)


def _draw(image: Gray, lamp: Lamp, time_s: float) -> None:
    """Draw a lamp as it shines on average over an exposure; its place is that of the middle."""
    import cv2

    light = lamp.light(time_s + SUBSTEPS).mean(-1)
    x, y = (a + v * (time_s + 0.5 / RATE_HZ) for a, v in zip(lamp.at, lamp.speed, strict=True))
    if lamp.picture is not None:
        _draw_sign(image, lamp, np.asarray(light))
        return
    shade, fine = int(20 + 235 * float(light)), 16  # 16ths of a pixel
    if lamp.round:
        cv2.circle(image, (round(x * fine), round(y * fine)), round(lamp.half[0] * fine), shade, -1, cv2.LINE_AA, 4)
        return
    corners = [(round((x + s * lamp.half[0]) * fine), round((y + s * lamp.half[1]) * fine)) for s in (-1, 1)]
    cv2.rectangle(image, corners[0], corners[1], shade, -1, cv2.LINE_AA, 4)


def _draw_sign(image: Gray, lamp: Lamp, light: NDArray[np.float64]) -> None:
    assert lamp.picture is not None
    size = max(1, round(2 * lamp.half[1] / lamp.picture.shape[0]))
    shades = 15 + 240 * lamp.picture * light[:, None]
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
    """A steady lamp of a vehicle, up to 0.7 px per frame."""
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
    picture = (rng.random((rows, int(rng.integers(6, 25)))) < 0.6).astype(np.uint8)
    turn = np.arange(rows)[:, None] % 4 / 4
    at, half, _ = _body(rng)
    return Lamp(at, half, False, (0, 0), lambda t: ((hz * t + phase + turn) % 1 < 0.25).astype(float), picture)


HeaderKind = Literal["m_sequence", "all_on"]


@dataclass(frozen=True, slots=True)
class ClutterFilm:
    """A short film."""

    # Frames in the order of time, from before the header on
    frames: list[Frame]
    # Number of the frame in which the first array's header begins, or would begin
    first: int
    # Pose of each array in the frame after that in which its header begins
    truths: tuple[Pose, ...]

    @property
    def truth(self) -> Pose | None:
        """Pose of the only array; None: there is none."""
        return self.truths[0] if self.truths else None


def backdrops(clips: Mapping[str, Path], reach: int) -> dict[str, Backdrop]:
    """All scenes by name: each clip, a drawn street at rest, and one full of changing lamps."""
    scenes: dict[str, Backdrop] = {name: ClipBackdrop(path, reach) for name, path in clips.items()}
    return {**scenes, "drawn scene": drawn_backdrop, "lamps": lamp_backdrop}


@dataclass(frozen=True, slots=True)
class ClipBackdrop:
    """Moments between two successive frames of a clip; the channel fades one into the other."""

    # File of the clip
    path: Path
    # Frames of it that are used, from the first on
    reach: int

    def __call__(self, rng: np.random.Generator) -> Moment:
        """Draw a moment."""
        rate_hz, pairs = _clip_pairs(ClipVersion.of(self.path), self.reach)
        one, other = pairs[int(rng.integers(len(pairs)))]
        room = max(1 / rate_hz - FRAMES / RATE_HZ, 0.0)
        return Moment(Footage(lambda: iter([one, other]), rate_hz), float(rng.uniform(0, room)))


@dataclass(frozen=True, slots=True)
class ClipVersion:
    """A clip as it is in its file now: a cache of its frames must not outlive a change of the file."""

    # File of the clip
    path: Path
    # changed_ns, size_bytes: when it was last changed, in ns since 1970, and its size in bytes
    changed_ns: int
    size_bytes: int

    @classmethod
    def of(cls, path: Path) -> Self:
        """Return the clip in a file."""
        try:
            found = path.stat()
        except OSError as error:
            raise MediaError(f"cannot read {path}: {error.strerror}") from None
        return cls(path, found.st_mtime_ns, found.st_size)


@lru_cache(maxsize=8)
def _clip_pairs(clip: ClipVersion, reach: int) -> tuple[float, list[tuple[Gray, Gray]]]:
    """A clip's rate, and pairs of successive frames; read once in each process."""
    from heliograph.channel.background import cover_size

    source = load_footage(clip.path)
    # places of a clip that are used, evenly spread: each costs 1.5 MB
    step = max(2, -(-reach // 32))
    held: dict[int, Gray] = {}
    for k, frame in enumerate(islice(source.frames(), reach)):
        if k % step < 2:
            held[k] = cover_size(frame, SIZE)
    return source.rate_hz, [(held[k], held[k + 1]) for k in held if k % step == 0 and k + 1 in held]


def film_moment(
    moment: Moment,
    rng: np.random.Generator,
    imu: ImuTrace | None,
    distance_m: float | None = None,
    header: HeaderKind = "m_sequence",
    identities: Sequence[int] = (0,),
    over: ChannelSettings | None = None,
) -> ClutterFilm:
    """Film a moment of a scene in the reference link."""
    base = over or load_settings("paper").channel
    start = moment.start_s
    camera = replace(base.camera, start_s=start)
    places = over.arrays if over else (_placed(distance_m or 50.0, base, rng),)
    settings = replace(
        base,
        distance_m=(distance_m or 50.0) + base.speed_m_s * start,
        duration_s=start + FRAMES / RATE_HZ,
        shake="imu" if imu else "road",
        road_class="C",
        imu_start_s=float(rng.uniform(0, imu.t_s[-1])) if imu else 0.0,
        background=replace(base.background, kind="footage"),
        camera=camera,
        arrays=tuple(replace(place, start_s=start) for place in places) if distance_m else (),
    )
    firsts, lights = [], []
    for identity in identities:
        # frames of a film before the header's four: the packet's end, of either phase
        firsts.append(int(rng.choice((2, 3))))
        lights.append(_patterns(header, identity, firsts[-1], rng) if distance_m else [])
    lights = lights if distance_m else []
    shots = list(film(settings, lights, rng, pattern_period_s=1e-3, footage=moment.footage, imu=imu))
    truths = [shots[first + 1][1].arrays[k] for k, first in enumerate(firsts)] if distance_m else []
    return ClutterFilm(
        [frame for frame, _ in shots], firsts[0], tuple(Pose(t.x, t.y, t.pitch_px, t.roll_rad) for t in truths)
    )


def _placed(distance_m: float, settings: ChannelSettings, rng: np.random.Generator) -> Placement:
    """Somewhere on the sensor, 64 px from its edges."""
    camera = settings.camera
    reach = [(size / 2 - 64) * distance_m / camera.focal_px for size in (camera.width, camera.height)]
    x, y = (float(rng.uniform(-r, r)) for r in reach)
    return Placement(x_m=x, y_m=y)


def _patterns(header: HeaderKind, identity: int, first: int, rng: np.random.Generator) -> list[NDArray[np.uint8]]:
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
