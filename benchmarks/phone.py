"""Screens filmed by phones, under conditions drawn at random.

`python -m benchmarks.phone [FILMS] [SEED] [RATE ...] [cells=N] [show]`, RATE of `phone`, `phone-15`, `phone-60`,
`phone-240`, `phone-slow`. Each film is written as a phone writes it (H.264 or H.265 at a bit rate, 4:2:0, limited
range) and read by the receiver "screen" with its default settings. Drawn are the size of the array and the frame,
place, perspective and sway, blur, rolling shutter, exposure, response and backlight of the display, gamma, automatic
exposure and white balance, phases and clocks, unevenness of the frames, lost frames, codec and bit rate.
"""

import sys
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import heliograph
from heliograph.link.film import write_film
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import random_messages
from heliograph.measure.statistics import clopper_pearson
from heliograph.receive import Packet
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS

RATES = ("phone", "phone-15", "phone-60", "phone-240", "phone-slow")
"""Presets that are measured."""

PACKETS = 2.1
"""Packets of a film: one or two are whole, whatever the phase. Chosen."""

SIDES_PX = (50.0, 800.0)
"""Sides of the array that are drawn, evenly by their logarithm."""

HEIGHTS = (720, 1080)
"""Rows of a frame; an array of more than 0.7 of the smaller one is filmed by the larger."""

LEAST_FILM_S = 1.5
"""Least length of a film. Chosen: an array is looked for in the first frames."""


@dataclass(frozen=True)
class Condition:
    """What is drawn of a film.

    Attributes
    ----------
    settings
        The link.
    codec
        Codec and bit rate, options of `write_film`.
    side_px
        Side of the array in px.
    """

    settings: LinkSettings
    codec: dict[str, Any]
    side_px: float

    @property
    def row(self) -> str:
        """What was drawn, in a line."""
        s = self.settings
        c, e, one = s.channel.camera, s.channel.emitter, s.channel.arrays[0]
        readout, angles = 1e3 * c.row_time_s * c.height, f"{one.yaw_deg:.0f} {one.pitch_deg:.0f} {one.roll_deg:.0f}"
        return ", ".join(
            [
                f"{self.side_px:4.0f} px in {c.height}p",
                f"blur {c.blur_px:.1f} px",
                f"rows {readout:.0f} ms",
                f"exposure {1e3 * c.exposure_s:.1f} ms",
                f"response {1e3 * e.response_s:.0f} ms",
                f"backlight {e.backlight_hz:.0f} Hz {e.backlight_duty:.1f}",
                f"gamma {s.channel.sensor.gamma:.2f}",
                f"swing {c.gain_swing:.2f}",
                f"white balance {c.white_balance_swing:.2f}",
                f"tilt {angles}",
                f"sway {s.channel.hand_deg:.2f} deg",
                f"{self.codec['codec']} {self.codec['mbit_s']:.0f} Mbit/s",
            ]
        )


def drawn(rate: str, rng: np.random.Generator, cells: int = 16, *changes: str) -> Condition:
    """Draw the conditions of a film.

    Parameters
    ----------
    rate
        Preset.
    rng
        Draws them.
    cells
        Cells in a row of the array.
    changes
        Settings laid over them.
    """
    base = load_settings(rate)
    fps, period = base.channel.camera.fps, base.signal.pattern_period_s
    side = float(np.exp(rng.uniform(*np.log(SIDES_PX))))
    height = HEIGHTS[side > 0.7 * HEIGHTS[0]]
    width = 16 * height // 9
    focal_px, pitch = 0.75 * width, 0.32 / cells
    distance = 0.32 * focal_px / side
    # all of it stays in the picture while a hand sways
    room = np.maximum((np.array([width, height]) - 1.5 * side) / 2 - 30, 0) / focal_px * distance
    tilt, roll = (20, 15) if side < 0.55 * height else (8, 4)
    x, y = rng.uniform(-room, room)
    readout = min(rng.uniform(0.005, 0.03), 0.98 / fps)
    pwm = rng.random() < 0.5
    swing = rng.uniform(0, 0.2)
    values = {
        "signal.side": cells,
        "transmit.identities": f"[{rng.integers(30)}]",
        "channel.distance_m": distance,
        "channel.duration_s": max(PACKETS * base.signal.packet_s, LEAST_FILM_S),
        "channel.hand_deg": rng.uniform(0.1, 0.4),
        "channel.arrays.0.x_m": x,
        "channel.arrays.0.y_m": y,
        "channel.arrays.0.yaw_deg": rng.uniform(-tilt, tilt),
        "channel.arrays.0.pitch_deg": rng.uniform(-tilt, tilt),
        "channel.arrays.0.roll_deg": rng.uniform(-roll, roll),
        "channel.arrays.0.clock_ppm": rng.uniform(-100, 100),
        "channel.arrays.0.start_s": -rng.uniform(0, base.signal.packet_s),
        "channel.camera.width": width,
        "channel.camera.height": height,
        "channel.camera.pixel_m": 0.004 / focal_px,
        "channel.camera.blur_px": rng.uniform(0.6, 1.6),
        "channel.camera.clock_ppm": rng.uniform(-100, 100),
        "channel.camera.exposure_s": min(rng.uniform(0.15, 0.95) / fps, period),
        "channel.camera.start_s": rng.uniform(0, 2 * period),
        "channel.camera.row_time_s": readout / height,
        "channel.camera.jitter_s": rng.uniform(0, 0.02) / fps,
        "channel.camera.uneven_s": rng.uniform(0, 0.08) / fps,
        "channel.camera.dropped": rng.uniform(0, 0.02),
        "channel.camera.repeated": rng.uniform(0, 0.01),
        "channel.camera.gain_swing": swing,
        "channel.camera.gain_period_s": rng.uniform(1.5, 8),
        "channel.emitter.pitch_m": pitch,
        "channel.emitter.diameter_m": pitch / 4,
        "channel.emitter.response_s": rng.uniform(0.002, 0.015),
        "channel.emitter.backlight_hz": rng.uniform(180, 1000) if pwm else 0.0,
        "channel.emitter.backlight_duty": rng.uniform(0.3, 0.9) if pwm else 1.0,
        "channel.emitter.scan_s": rng.uniform(0, 0.016),
        # brighter than full scale nowhere
        "channel.emitter.all_on": rng.uniform(0.3, 0.85) / (1 + swing),
        "channel.emitter.panel_level": rng.uniform(0.005, 0.05),
        "channel.background.level": rng.uniform(0.0, 0.3),
        "channel.sensor.gamma": rng.uniform(1.8, 2.6),
    }
    codec = {"codec": "h265" if rng.random() < 0.1 else "h264", "mbit_s": float(rng.uniform(10, 40))}
    # drawn last, so that all else is as it was before there was white balance
    values |= {
        "channel.camera.white_balance_swing": rng.uniform(0, 0.25),
        "channel.camera.white_balance_period_s": rng.uniform(1.5, 8),
        "channel.emitter.colour": _tinted(rng),
        "channel.background.colour": _tinted(rng),
    }
    texts = [f"{key}={value}" for key, value in values.items()]
    return Condition(load_settings(rate, None, [*texts, *changes]), codec, side)


def _tinted(rng: np.random.Generator) -> list[float]:
    """A colour from that of a lamp, or of a display's night colours, to that of a cold display."""
    warmth = rng.uniform(-0.4, 0.4)
    return [1 + warmth, 1.0, 1 - warmth]


@dataclass
class Counts:
    """Packets and codewords of films."""

    sent: int = 0
    read: int = 0
    films: int = 0
    found: int = 0
    false: int = 0
    seconds: float = 0.0
    frames: int = 0

    def __post_init__(self) -> None:
        self.words = {name: [0, 0] for name in LAYERS}

    def __str__(self) -> str:
        low, high = clopper_pearson(self.read, self.sent)
        layers = ", ".join(f"{name} {a}/{b}" for name, (a, b) in self.words.items())
        return (
            f"films with an array found {self.found}/{self.films}, packets whole {self.read}/{self.sent} ({low:.3f} to "
            f"{high:.3f}), codewords {layers}, false {self.false}"
        )


def filmed(one: Condition, seed: int) -> tuple[list[Packet], int, float]:
    """Write a film, read it, and return its packets, its frames and the seconds of reading.

    Parameters
    ----------
    one
        Conditions of the film.
    seed
        Seed of messages, sway and noise.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "phone.mp4"
        frames = write_film(path, one.settings, random_messages(one.settings, seed), seed, **one.codec)
        begun = time.process_time()
        with heliograph.open_film(path) as film:
            packets = list(heliograph.receive_frames(film, one.settings.signal, one.settings.receive))
        return packets, frames, time.process_time() - begun


def counted(one: Condition, seed: int, counts: Counts) -> str:
    """Count a film's packets that were sent whole within it; return its outcome in a line.

    Parameters
    ----------
    one
        Conditions of the film.
    seed
        Its seed.
    counts
        What is counted, added to.
    """
    packets, frames, seconds = filmed(one, seed)
    s = one.settings
    content = random_messages(s, seed)[0]
    begins = list(_whole(s))
    layers = PacketFormat(s.signal, s.transmit.formats[0]).layers
    period = s.signal.packet_s
    got: Counter[str] = Counter()
    whole = 0
    for start in begins:
        near = [
            p for p in packets if abs(p.start_time_s - start) < period / 4 and p.identity == s.transmit.identities[0]
        ]
        good = {name: sum(w.status == "ok" for w in near[0].layers.get(name, ())) if near else 0 for name in LAYERS}
        got.update(good)
        whole += all(good[name] == layer.codewords for name, layer in layers.items())
    for packet in packets:
        for name, words in packet.layers.items():
            blocks = [word.block for word in words if word.block is not None]
            counts.false += sum(block.payload not in content[name][0] for block in blocks)
    counts.sent += len(begins)
    counts.read += whole
    counts.films += 1
    counts.found += bool(packets)
    counts.seconds += seconds
    counts.frames += frames
    for name, layer in layers.items():
        counts.words[name][0] += got[name]
        counts.words[name][1] += layer.codewords * len(begins)
    return f"{whole}/{len(begins)} {dict(got)} {one.row}"


def _whole(s: LinkSettings) -> Iterator[float]:
    """Times by the camera's clock at which packets begin that are whole in a film."""
    camera, place = s.channel.camera, s.channel.arrays[0]
    length = s.signal.packet_s * (1 + 1e-6 * place.clock_ppm)
    duration = s.channel.duration_s or 0.0
    late = camera.row_time_s * camera.height + s.channel.emitter.scan_s
    number = 0
    while (start := place.start_s + number * length) + length + late + camera.exposure_s < duration:
        if start + late > camera.start_s + camera.exposure_s:
            # stamps count from the first exposure by the camera's own clock
            yield camera.start_s + (start - camera.start_s) / (1 + 1e-6 * camera.clock_ppm)
        number += 1


def measured(rate: str, films: int, seed: int, cells: int = 16, show: bool = False) -> Counts:
    """Measure a rate.

    Parameters
    ----------
    rate
        Preset.
    films
        Films that are drawn.
    seed
        Seed of all of them.
    cells
        Cells in a row of the array.
    show
        Whether each film's outcome is printed.
    """
    counts = Counts()
    for k in range(films):
        one = drawn(rate, np.random.default_rng([seed, k, RATES.index(rate), cells]), cells)
        row = counted(one, 1000 * seed + k, counts)
        if show:
            print(f"  {k} {row}", flush=True)
    return counts


def main() -> None:
    """Print a line for each rate."""
    films = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    seed = int(sys.argv[2]) if len(sys.argv) > 2 else 1
    rates = [name for name in sys.argv[3:] if name in RATES] or RATES
    cells = next((int(name[6:]) for name in sys.argv if name.startswith("cells=")), 16)
    for rate in rates:
        s = load_settings(rate, None, [f"signal.side={cells}"])
        counts = measured(rate, films, seed, cells, "show" in sys.argv)
        layers = PacketFormat(s.signal, s.transmit.formats[0]).layers
        gross = cells**2 / (2 * s.signal.pattern_period_s)
        net = sum(8 * one.payload_bytes * one.codewords for one in layers.values()) / s.signal.packet_s
        print(
            f"{rate}, {cells} x {cells} cells: {1 / s.signal.pattern_period_s:g} patterns/s at "
            f"{s.channel.camera.fps:g} frames/s, {s.signal.packet_s:g} s a packet, {gross / 1e3:.2f} kbit/s gross, "
            f"{net / 1e3:.2f} kbit/s of payload: {counts}; "
            f"{1e3 * counts.seconds / max(counts.frames, 1):.0f} ms of processor time a frame"
        )


if __name__ == "__main__":
    main()
