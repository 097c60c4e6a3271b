"""Short films of clutter that a detector may take for an array: footage and lamps before a shaking camera."""

from collections.abc import Mapping, Sequence
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
from heliograph.experiments.detection.lamps import (
    FRAMES,
    RATE_HZ,
    SIZE,
    Backdrop,
    Moment,
    drawn_backdrop,
    lamp_backdrop,
)
from heliograph.link.recordings import load_footage
from heliograph.link.settings import load_settings
from heliograph.receive import Pose
from heliograph.signal.block import Block
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

HeaderKind = Literal["m_sequence", "all_on"]

LEAD = (2, 3)
"""Frames of a film before the header's four: the packet's end, of either phase."""

MOST_PAIRS = 32
"""Places of a clip that are used, evenly spread: each costs 1.5 MB."""


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
    step = max(2, -(-reach // MOST_PAIRS))
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
        firsts.append(int(rng.choice(LEAD)))
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
