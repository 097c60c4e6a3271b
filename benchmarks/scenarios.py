"""Scenarios for `benchmarks.behaviour`: seeded random films and their receivers."""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator

from heliograph.base.frames import Frame
from heliograph.channel.truth import Truth
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, load_footage, load_imu
from heliograph.signal.settings import LAYERS

DATA = Path(os.environ.get("HELIOGRAPH_DATA", Path(__file__).parents[2] / "shared" / "data"))
ARRAY = "channel.arrays.0."
BOTH = ("plain", "soft")
SOFT = ("soft",)
PHONES = ("phone", "phone-15", "phone-60", "phone-240", "phone-slow")

Alter = Callable[[Frame, Truth], Frame]


@dataclass(frozen=True)
class Film:
    """A film in a scenario: number of packets (None: duration from settings) and a per-frame modification."""

    settings: LinkSettings
    packets: int | None = 4
    alter: Alter | None = None
    recordings: Recordings | None = None
    whole_frames: bool = False
    # H.264 bit rate; None for uncompressed frames
    mbit_s: float | None = None
    repeated_messages: bool = False


@dataclass(frozen=True)
class Scenario:
    """Seeded random films and the receivers to test."""

    draw: Callable[[Generator, int], Film]
    films: int
    receivers: Sequence[str] = BOTH


SCENARIOS: dict[str, Scenario] = {}


def scenario(name: str, films: int, receivers: Sequence[str] = BOTH) -> Callable[[Any], Any]:
    """Register the decorated function as a scenario."""

    def register(draw: Callable[[Generator, int], Film]) -> Callable[[Generator, int], Film]:
        SCENARIOS[name] = Scenario(draw, films, receivers)
        return draw

    return register


def link(preset: str, *changes: str, **channel: Any) -> LinkSettings:
    """Load a preset with changes; keywords set channel keys."""
    return load_settings(preset, None, [*(f"channel.{key}={value}" for key, value in channel.items()), *changes])


@dataclass(frozen=True)
class Post:
    """A post with vertical edges passing in front of an array."""

    # First and last contact with the array in seconds
    start_s: float
    end_s: float
    # Width relative to the array side
    width: float
    # Gray level, 0 to 255
    level: float
    # 1 from the left, -1 from the right
    side: int

    def draw(self, frame: Frame, truth: Truth, rng: Generator) -> Frame:
        """Draw the noisy post in front of the array."""
        array, leds = truth.arrays[0], 16
        length = leds * array.pitch_px
        travelled = (frame.time_s - self.start_s) / (self.end_s - self.start_s) * (1 + self.width) * length
        centre = array.x + self.side * (travelled - 0.5 * length - 0.5 * self.width * length)
        columns = np.arange(frame.pixels.shape[1]) + frame.origin[0]
        # covered fraction per pixel column
        reach = 0.5 * self.width * length + 0.5
        hides = np.clip(reach - np.abs(columns - centre), 0, 1)
        if not hides.any():
            return frame
        post = rng.normal(self.level, 1.5, frame.pixels.shape)
        mixed = frame.pixels + hides * (post - frame.pixels)
        return replace(frame, pixels=np.clip(np.round(mixed), 0, 255).astype(frame.pixels.dtype))


def draw_passage(rng: Generator) -> tuple[LinkSettings, Post, int]:
    """Draw link, post and film seed; the passage lasts 0.1 to 1 s, log-uniform."""
    start_s, span_s = rng.uniform(0.11, 0.21), math.exp(rng.uniform(*np.log((0.1, 1.0))))
    post = Post(start_s, start_s + span_s, rng.uniform(1, 3), rng.uniform(5, 150), int(rng.choice([-1, 1])))
    channel = {
        "distance_m": rng.uniform(40, 95),
        "speed_m_s": rng.uniform(0, 50 / 3.6),
        "road_class": str(rng.choice(["A", "B", "C"])),
        "background": {"kind": str(rng.choice(["flat", "synthetic"]))},
        "arrays": [{"x_m": rng.uniform(-2, 2), "y_m": rng.uniform(-1, 0)}],
        "stop_m": 10.0,
        "duration_s": 0.1 * math.ceil(post.end_s / 0.1) + 0.112,
    }
    return load_settings("paper", {"channel": channel}), post, int(rng.integers(2**31))


def draw_phone(preset: str, rng: Generator, **changes: Any) -> LinkSettings:
    """Draw settings for a phone filming a screen; `changes` replace drawn values."""
    base = load_settings(preset)
    fps, period = base.channel.camera.fps, base.signal.pattern_period_s
    side = float(np.exp(rng.uniform(*np.log((50.0, 800.0)))))
    height = 1080 if side > 0.7 * 720 else 720
    width = 16 * height // 9
    focal_px, pitch = 0.75 * width, 0.32 / 16
    distance = 0.32 * focal_px / side
    # keep the array inside the frame despite hand shake
    room = np.maximum((np.array([width, height]) - 1.5 * side) / 2 - 30, 0) / focal_px * distance
    tilt, roll = (20, 15) if side < 0.55 * height else (8, 4)
    x, y = rng.uniform(-room, room)
    readout = min(rng.uniform(0.005, 0.03), 0.98 / fps)
    pwm = rng.random() < 0.5
    swing = rng.uniform(0, 0.2)
    values = {
        "transmit.identities": f"[{rng.integers(30)}]",
        "channel.distance_m": distance,
        "channel.duration_s": max(2.1 * base.signal.packet_s, 1.5),
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
        # below full scale
        "channel.emitter.all_on": rng.uniform(0.3, 0.85) / (1 + swing),
        "channel.emitter.panel_level": rng.uniform(0.005, 0.05),
        "channel.background.level": rng.uniform(0.0, 0.3),
        "channel.sensor.gamma": rng.uniform(1.8, 2.6),
    }
    rng.random(2)  # keeps later draws equal to the reference, which drew a codec here
    values |= {
        "channel.camera.white_balance_swing": rng.uniform(0, 0.25),
        "channel.camera.white_balance_period_s": rng.uniform(1.5, 8),
        "channel.emitter.colour": _tinted(rng),
        "channel.background.colour": _tinted(rng),
    }
    return load_settings(preset, None, [f"{key}={value}" for key, value in (values | changes).items()])


FOCAL_PX = 0.75 * 1920  # of a phone in 1080p


def draw_near_phone(side: int, fps: int, rng: Generator, **changes: Any) -> Film:
    """Draw a 1080p film of a near screen: 30 degrees of tilt, glare, H.264; `changes` replace drawn values."""
    distance = 0.32 * FOCAL_PX / rng.uniform(650, 850)
    settings = draw_phone(
        {30: "phone-15", 60: "phone-60"}[fps],
        rng,
        **{f"transmit.formats.0.{layer}": "3/4" for layer in LAYERS},
        **{
            "signal.side": side,
            "channel.distance_m": distance,
            "channel.emitter.pitch_m": 0.32 / side,
            "channel.emitter.diameter_m": 0.08 / side,
            "channel.arrays.0.x_m": rng.uniform(-0.1, 0.1) * distance,
            "channel.arrays.0.y_m": 0.0,
            "channel.arrays.0.yaw_deg": rng.uniform(-30, 30),
            "channel.arrays.0.pitch_deg": rng.uniform(-30, 30),
            "channel.arrays.0.roll_deg": rng.uniform(-4, 4),
            "channel.camera.width": 1920,
            "channel.camera.height": 1080,
            "channel.camera.pixel_m": 0.004 / FOCAL_PX,
            "channel.camera.row_time_s": min(rng.uniform(0.005, 0.03), 0.98 / fps) / 1080,
            "channel.emitter.panel_level": rng.uniform(0.005, 0.1),
        }
        | changes,
    )
    return Film(settings, None, whole_frames=True, mbit_s=rng.uniform(10, 40))


def _tinted(rng: np.random.Generator) -> list[float]:
    """Draw a colour between a warm lamp and a cold display."""
    warmth = rng.uniform(-0.4, 0.4)
    return [1 + warmth, 1.0, 1 - warmth]


def _register_static(distance_m: int) -> None:
    @scenario(f"static, {distance_m} m", 3)
    def _static(_rng: Generator, _number: int) -> Film:
        return Film(link("static", distance_m=distance_m), packets=6)


for _distance_m in (40, 60, 80, 105, 150, 220):
    _register_static(_distance_m)


@scenario("drive, 80 m to 25 m", 1)
def _drive(_rng: Generator, _number: int) -> Film:
    return Film(link("paper"), packets=None)


@scenario("bumps of the recorded shake over footage", 6)
def _bumps(rng: Generator, number: int) -> Film:
    start_s, distance_m = (1.0, 38.2)[number % 2], rng.uniform(40, 90)
    settings = link(
        "paper", distance_m=distance_m, stop_m=20, duration_s=1.0, shake="imu", imu_start_s=start_s,
        **{"background.kind": "footage"},
    )  # fmt: skip
    footage = load_footage(DATA / "driving" / ("day-motorway.mp4", "night-road.mp4")[number // 3])
    return Film(settings, None, recordings=Recordings(footage=footage, imu=load_imu(DATA / "motion" / "car-imu.csv")))


@scenario("posts that pass before the array", 12)
def _posts(rng: Generator, _number: int) -> Film:
    settings, post, _ = draw_passage(rng)
    return Film(settings, None, lambda frame, truth: post.draw(frame, truth, rng))


@scenario("crossing", 8)
def _crossing(rng: Generator, _number: int) -> Film:
    distance_m, speed_m_s, side = rng.uniform(15, 40), rng.uniform(25, 60) / 3.6, rng.choice([-1, 1])
    half_m = 0.164 * distance_m
    array = (f"x_m={-side * half_m}", f"vx_m_s={side * speed_m_s}", f"yaw_deg={rng.uniform(-25, 25)}")
    changes = [f"{ARRAY}{key}" for key in array]
    return Film(link("crossing", *changes, distance_m=distance_m, duration_s=2 * half_m / speed_m_s), None)


@scenario("near, 3 m to 30 m", 10)
def _near(rng: Generator, _number: int) -> Film:
    distance_m = float(np.exp(rng.uniform(np.log(3), np.log(30))))
    changes = (f"transmit.identities=[{rng.integers(30)}]", f"{ARRAY}yaw_deg={rng.uniform(-20, 20)}")
    return Film(link("static", *changes, distance_m=distance_m), 3, whole_frames=True)


@scenario("rotated and mirrored, 5 m to 40 m", 16)
def _turned(rng: Generator, number: int) -> Film:
    distance_m = float(np.exp(rng.uniform(np.log(5), np.log(40))))
    settings = link("static", f"transmit.identities=[{rng.integers(30)}]", distance_m=distance_m)

    def turn(frame: Frame, _truth: Truth) -> Frame:
        pixels = frame.pixels[:, ::-1] if number & 4 else frame.pixels
        return replace(frame, pixels=np.asarray(np.rot90(pixels, number & 3), np.uint8))

    return Film(settings, 2, turn, whole_frames=True)


@scenario("unsynchronised, six phases", 6, SOFT)
def _phases(rng: Generator, number: int) -> Film:
    changes = (f"{ARRAY}start_s={number / 6 * 1e-3}", f"{ARRAY}clock_ppm=100")
    return Film(link("static", *changes, distance_m=rng.uniform(30, 90)))


@scenario("unsynchronised, 1.3 to 4 frames per pattern", 8, SOFT)
def _oversampled(rng: Generator, _number: int) -> Film:
    fps = 1000 * rng.uniform(1.3, 4)
    changes = (f"{ARRAY}start_s={rng.uniform(0, 1e-3)}", f"{ARRAY}clock_ppm={rng.uniform(-100, 100)}")
    camera = {"camera.fps": fps, "camera.exposure_s": 0.95 / fps}
    return Film(link("static", *changes, distance_m=rng.uniform(30, 90), **camera), 2)


def _register_lost(name: str, gaps: bool) -> None:
    @scenario(f"2 % of the frames lost, {name}", 5)
    def _lost(rng: Generator, _number: int) -> Film:
        camera = {"camera.dropped": 0.02, "camera.gaps": str(gaps).lower()}
        return Film(link("static", distance_m=rng.uniform(30, 90), **camera))


_register_lost("with time stamps", gaps=True)
_register_lost("without", gaps=False)


@scenario("LEDs of 20 % spread, 15 % dead", 4)
def _unequal(rng: Generator, number: int) -> Film:
    change = (f"{ARRAY}spread=0.2", f"{ARRAY}dead=0.15")[number % 2]
    return Film(link("static", change, distance_m=rng.uniform(50, 100)), 8)


@scenario("single mode, 100 km/h", 3, SOFT)
def _single(rng: Generator, _number: int) -> Film:
    mode = "transmit.formats=[{mode='single', high='9/10', middle='3/4', low='1/2'}]"
    return Film(link("paper", mode, distance_m=rng.uniform(70, 95), speed_m_s=27.78, stop_m=25, duration_s=0.82), None)


@scenario("soft combining of repeated messages", 4, SOFT)
def _combining(rng: Generator, _number: int) -> Film:
    return Film(link("paper", distance_m=rng.uniform(150, 210), duration_s=1.02), None, repeated_messages=True)


@scenario("six arrays", 2)
def _six(rng: Generator, _number: int) -> Film:
    places = [f"{{x_m={x}, y_m={rng.uniform(-1, 1)}}}" for x in (-6, -3.6, -1.2, 1.2, 3.6, 6)]
    identities = rng.permutation(30)[:6].tolist()
    changes = (f"channel.arrays=[{', '.join(places)}]", f"transmit.identities={identities}")
    return Film(link("static", *changes, distance_m=rng.uniform(40, 70)), 3, whole_frames=True)


@scenario("flickering background", 6)
def _flicker(rng: Generator, _number: int) -> Film:
    settings = link("static", f"{ARRAY}x_m=2", distance_m=rng.uniform(20, 60))
    size, row, column = int(rng.integers(2, 21)), int(rng.integers(0, 300)), int(rng.integers(0, 200))

    def flicker(frame: Frame, _truth: Truth) -> Frame:
        pixels = frame.pixels.copy()
        squares = rng.integers(0, 256, (size, size), np.uint8)
        pixels[row : row + 8 * size, column : column + 8 * size] = np.kron(squares, np.ones((8, 8), np.uint8))
        return replace(frame, pixels=pixels)

    return Film(settings, 3, flicker, whole_frames=True)


@scenario("no array", 3)
def _empty(_rng: Generator, number: int) -> Film:
    footage = load_footage(DATA / "driving" / ("day-motorway.mp4", "day-shade.mp4", "night-road.mp4")[number])
    changes = ("channel.arrays=[]", "transmit.identities=[]", "channel.background.kind=footage")
    return Film(
        link("paper", *changes, duration_s=0.3), None, recordings=Recordings(footage=footage), whole_frames=True
    )


def _register_phone(rate: str) -> None:
    @scenario(f"preset {rate}", 2, ("screen",))
    def _phone(rng: Generator, _number: int) -> Film:
        return Film(draw_phone(rate, rng), None, whole_frames=True)


for _rate in PHONES:
    _register_phone(_rate)


def _register_near_phone(name: str, side: int, fps: int, **changes: Any) -> None:
    @scenario(name, 5, ("screen",))
    def _near_phone(rng: Generator, _number: int) -> Film:
        return draw_near_phone(side, fps, rng, **changes)


for _fps in (30, 60):
    for _side in (32, 48, 64, 96, 128):
        _register_near_phone(f"1080p{_fps}, {_side} cells", _side, _fps)
        _register_near_phone(
            f"1080p{_fps} without inverses, {_side} cells", _side, _fps, **{"transmit.formats.0.mode": "single"}
        )

for _px, _tilt, _hand in product((4, 5, 6, 8, 12), (0, 15, 30), (0.2, 1.0)):
    _register_near_phone(
        f"1080p map, {_px} px a cell, tilt {_tilt} deg, shake {_hand} deg", 64, 60,
        **{
            "channel.distance_m": 0.32 * FOCAL_PX / (64 * _px), "channel.arrays.0.x_m": 0.0,
            "channel.arrays.0.yaw_deg": _tilt, "channel.arrays.0.pitch_deg": 0.0, "channel.hand_deg": _hand,
        },
    )  # fmt: skip
