"""Codewords received in fixed scenarios: the reference table for every change of the receivers.

    python -m benchmarks.behaviour [SCENARIO ...] [--write] [--workers 2]

The films of a scenario are drawn by fixed seeds, and every receiver of the scenario gets the same frames. Prints a
table of codewords right of sent by layer, undetected errors, and packets that were never sent. The reference in
`benchmarks/behaviour.csv` stands in brackets beside counts that differ. The exit status is 1 if a count lies outside
the 95 % interval of the reference; --write replaces the reference.
"""

import argparse
import csv
import os
import sys
import zlib
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before NumPy is imported

import numpy as np
from numpy.random import Generator

from benchmarks import phone, poles
from heliograph.base.frames import Frame
from heliograph.channel import Truth
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Messages, Recordings, default_messages, load_footage, load_imu, simulate
from heliograph.link.truth import FrameTruth
from heliograph.measure.bench import block_settings, dithered, random_messages, window_margin_px
from heliograph.measure.reception import Reception, receive_film
from heliograph.measure.statistics import clopper_pearson
from heliograph.signal.settings import LAYERS

REFERENCE = Path(__file__).with_suffix(".csv")
DATA = Path(os.environ.get("HELIOGRAPH_DATA", Path(__file__).parents[2] / "shared" / "data"))
ARRAY = "channel.arrays.0."
BOTH = ("plain", "soft")
SOFT = ("soft",)

Alter = Callable[[Frame, Truth], Frame]


@dataclass(frozen=True)
class Film:
    """One film of a scenario: whole packets (or the length in the settings), and a change made to each frame."""

    settings: LinkSettings
    packets: int | None = 4
    alter: Alter | None = None
    recordings: Recordings | None = None
    whole_frames: bool = False
    repeated_messages: bool = False


@dataclass(frozen=True)
class Scenario:
    """Films drawn one by one from generators of fixed seeds, and the receivers that read them."""

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
    """Settings of a preset with changes; keywords are keys of the channel."""
    return load_settings(preset, None, [*(f"channel.{key}={value}" for key, value in channel.items()), *changes])


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
    passage = poles.draw(rng)
    return Film(passage.settings, None, lambda frame, truth: passage.post.before(frame, truth, rng))


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
        return Film(phone.drawn(rate, rng).settings, None, whole_frames=True)


for _rate in phone.RATES:
    _register_phone(_rate)


class RenderedFilm:
    """Frames kept in memory with the truth of each; a `FrameSource` and a `TruthSource`."""

    path = "the film"

    def __init__(
        self, frames: Sequence[tuple[Frame, FrameTruth]], settings: LinkSettings, messages: Sequence[Messages]
    ):
        self._frames, self.settings, self.messages = frames, settings, messages

    def __iter__(self) -> Iterator[Frame]:
        return (frame for frame, _ in self._frames)

    def frames(self) -> Iterator[FrameTruth]:
        return (truth for _, truth in self._frames)


def render(film: Film, seed: int) -> RenderedFilm:
    """Render a film into memory."""
    settings = film.settings if film.packets is None else dithered(block_settings(film.settings, film.packets), seed)
    messages: Sequence[Messages] = random_messages(settings, seed)
    if film.repeated_messages:
        messages = default_messages(settings)
    margin = None if film.whole_frames else window_margin_px(settings)
    frames = [
        (film.alter(frame, truth) if film.alter else frame, _frame_truth(truth))
        for frame, truth in simulate(settings, messages, seed, film.recordings, margin)
    ]
    return RenderedFilm(frames, settings, messages)


def _frame_truth(truth: Truth) -> FrameTruth:
    return FrameTruth(
        truth.index, truth.time_s, [one.distance_m for one in truth.arrays], [one.visible for one in truth.arrays]
    )


FAULTS = ("undetected errors", "foreign packets")

Row = dict[str, int]


def count(name: str, number: int) -> dict[str, Row]:
    """Counts of one film by receiver: codewords sent and right by layer, undetected errors, foreign packets."""
    limit_threads()
    one = SCENARIOS[name]
    seed = zlib.crc32(f"{name} {number}".encode())
    rendered = render(one.draw(np.random.default_rng(seed), number), seed & 0xFFFF)
    rows = {}
    for receiver in one.receivers:
        settings = replace(rendered.settings, receive=replace(rendered.settings.receive, receiver=receiver))
        reception = Reception(rendered)
        deque(receive_film(rendered, settings.signal, settings, reception), maxlen=0)
        errors = reception.errors
        assert errors is not None  # the truth is known
        row = {"undetected errors": errors.false_codewords, "foreign packets": errors.false_packets}
        for layer in LAYERS:
            counts = [layers[layer] for layers in errors.bins().values()]
            row[f"{layer} sent"] = sum(of.codewords for of in counts)
            row[f"{layer} right"] = sum(of.codewords - of.codeword_errors for of in counts)
        rows[receiver] = row
    return rows


def run(names: Iterable[str], workers: int) -> Iterator[tuple[str, str, Row]]:
    """Counts of each scenario and receiver, all films together."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        films = {name: [pool.submit(count, name, k) for k in range(SCENARIOS[name].films)] for name in names}
        for name, done in films.items():
            for receiver in SCENARIOS[name].receivers:
                rows = [each.result()[receiver] for each in done]
                yield name, receiver, {key: sum(row[key] for row in rows) for key in rows[0]}


def read_reference() -> dict[tuple[str, str], Row]:
    """The reference by scenario and receiver."""
    with REFERENCE.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {(row.pop("scenario"), row.pop("receiver")): {key: int(n) for key, n in row.items()} for row in rows}


def differs(row: Row, before: Row) -> bool:
    """True if right codewords lie outside the reference's 95 % interval, or more errors are undetected."""
    for layer in LAYERS:
        sent, right = before[f"{layer} sent"], before[f"{layer} right"]
        low, high = clopper_pearson(right, sent) if sent else (0.0, 1.0)
        now = row[f"{layer} right"] / max(row[f"{layer} sent"], 1)
        if row[f"{layer} sent"] != sent or not low <= now <= high:
            return True
    return row["undetected errors"] > before["undetected errors"]


def format_row(name: str, receiver: str, row: Row, before: Row) -> str:
    """A row of the table in Markdown; differing references stand in brackets."""

    def cell(right: str, sent: str | None = None) -> str:
        was = before.get(right, row[right])
        return f"{row[right]}{f'/{row[sent]}' if sent else ''}{'' if was == row[right] else f' ({was})'}"

    layers = [cell(f"{layer} right", f"{layer} sent") for layer in LAYERS]
    return f"| {name} | {receiver} | {' | '.join([*layers, *map(cell, FAULTS)])} |"


def main() -> int:
    """Print the table; 1 if it differs from the reference."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help="beginnings of names; default: all")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    names = [name for name in SCENARIOS if not given.scenarios or name.startswith(tuple(given.scenarios))]
    reference = read_reference() if REFERENCE.exists() else {}
    print(f"| scenario | receiver | {' | '.join(LAYERS)} | {' | '.join(FAULTS)} |\n|{'---|' * 7}")
    found, total, outside = dict(reference), {"sent": 0, "right": 0, "before": 0}, []
    for name, receiver, row in run(names, given.workers):
        before = reference.get((name, receiver), {})
        print(format_row(name, receiver, row, before), flush=True)
        found[name, receiver] = row
        for key, of, part in (("sent", row, "sent"), ("right", row, "right"), ("before", before, "right")):
            total[key] += sum(of.get(f"{layer} {part}", 0) for layer in LAYERS)
        if before and differs(row, before):
            outside.append(f"{name}, {receiver}")
    print(f"\nright {total['right']} of {total['sent']} codewords; in the reference {total['before']}")
    print("\n".join(f"outside the interval of the reference: {one}" for one in outside))
    if given.write:
        keys = [*(f"{layer} {part}" for layer in LAYERS for part in ("sent", "right")), *FAULTS]
        with REFERENCE.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(["scenario", "receiver", *keys])
            order = [(name, receiver) for name, one in SCENARIOS.items() for receiver in one.receivers]
            writer.writerows([*key, *(found[key][k] for k in keys)] for key in order if key in found)
    return int(bool(outside))


if __name__ == "__main__":
    sys.exit(main())
