"""Small array films with a single fault each, as delivered by a camera: no metadata, no truth."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scenes
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.channel.camera import film as filmed
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import default_messages, simulate
from heliograph.media import create_film


@dataclass
class KeptFilm:
    """In-memory film with the interface of an opened film."""

    frames: Sequence[Frame]
    rate_hz: float = 1000.0
    path: Path = Path("the film")
    metadata: dict[str, str] = field(default_factory=dict)

    @property
    def frame_count(self) -> int:
        return len(self.frames)

    width = property(lambda self: int(self.frames[0].pixels.shape[1]))
    height = property(lambda self: int(self.frames[0].pixels.shape[0]))
    bits = property(lambda self: int(self.frames[0].bits))

    def __iter__(self) -> Iterator[Frame]:
        return iter(self.frames)


CAMERA = {"width": 160, "height": 120}


def link(*changes: str, **channel: Any) -> LinkSettings:
    """Return a small camera that faces the array for a packet and a third."""
    return scenes.link(*changes, **{"duration_s": 0.13, "camera": CAMERA, **channel})


def film(settings: LinkSettings, seed: int = 1) -> list[Frame]:
    return [frame for frame, _ in simulate(settings, default_messages(settings), seed)]


def kept(settings: LinkSettings, change: Callable[[Frame], Frame] | None = None, rate_hz: float = 0.0) -> KeptFilm:
    """Simulate a link film and change each frame."""
    frames = film(settings)
    return KeptFilm(list(map(change, frames)) if change else frames, rate_hz or settings.channel.camera.fps)


def mirrored(frame: Frame) -> Frame:
    pixels: Any = np.ascontiguousarray(frame.pixels[:, ::-1])
    return replace(frame, pixels=pixels)


def slowed(factor: float) -> Callable[[Frame], Frame]:
    """Stretch timestamps, as in a slow-motion file."""
    return lambda frame: replace(frame, time_s=frame.time_s * factor)


def shown(patterns: Sequence[NDArray[np.uint8]], settings: LinkSettings, seed: int = 1) -> KeptFilm:
    """Film lamps that repeat a pattern sequence."""

    def endless() -> Iterator[NDArray[np.uint8]]:
        while True:
            yield from patterns

    timed = filmed(settings.channel, [endless()], np.random.default_rng(seed), pattern_period_s=1e-3)
    return KeptFilm([frame for frame, _ in timed], settings.channel.camera.fps)


def blinking_square() -> KeptFilm:
    """Film an array-sized lamp that is on and off for three frames each."""
    on = np.full((16, 16), 4, np.uint8)
    return shown([*[on] * 3, *[0 * on] * 3], link())


def write(film: KeptFilm, path: Path) -> Path:
    """Write a film file without metadata."""
    with create_film(path, width=film.width, height=film.height, rate_hz=film.rate_hz, bits=film.bits) as target:
        for frame in film.frames:
            target.write(frame)
    return path


FAULTY: dict[str, Callable[[], KeptFilm]] = {
    "too small": lambda: kept(link(distance_m=330.0, duration_s=0.22)),
    "too large": lambda: kept(link(distance_m=14.0, camera={"width": 112, "height": 112})),
    "too dim": lambda: kept(link(emitter={"all_on": 0.022})),
    "saturated": lambda: kept(link(emitter={"all_on": 4.0}, arrays=[{"x_m": 0, "y_m": 0, "brightness": 8.0}])),
    "out of focus": lambda: kept(link(camera={**CAMERA, "blur_px": 6.0})),
    "no header": blinking_square,
    "half the rate": lambda: kept(link("signal.pattern_period_s=0.002", duration_s=0.21)),
    "mislabelled": lambda: kept(link(), slowed(1000 / 30), 30.0),
    "wrong side": lambda: kept(link("signal.side=8", emitter={"pitch_m": 0.04})),
    "moving": lambda: kept(link(arrays=[{"x_m": -0.9, "y_m": 0, "vx_m_s": 80.0}], duration_s=0.03)),
    "nothing blinks": lambda: kept(link(arrays=[{"x_m": 0, "y_m": 0, "brightness": 0.0}])),
    "cut": lambda: kept(link(arrays=[{"x_m": 1.27, "y_m": 0}])),
    "hidden": lambda: kept(link(arrays=[{"x_m": 0, "y_m": 0, "hidden": (0, 0, 1, 0.6)}])),
    "other packets": lambda: kept(link("signal.header_pairs=1", "signal.data_pairs=30")),
    "out of step": lambda: kept(link(duration_s=0.21, camera={**CAMERA, "start_s": 0.0005})),
    "slow camera": lambda: kept(link(camera={**CAMERA, "fps": 700.0})),
}
"""Films that the default receiver cannot decode."""
