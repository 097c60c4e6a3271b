"""Codewords received in fixed scenarios: the reference table for receiver changes.

    python -m benchmarks.behaviour [SCENARIO ...] [--write | --films N] [--workers 2]
    python -m benchmarks.behaviour 1080p --payload

Fixed seeds define the films, and all receivers in a scenario read the same frames. The table lists correct and sent
codewords per layer, undetected errors and false packets. If a count differs from `benchmarks/behaviour.csv`, the
reference follows in brackets. The exit status is 1 if a count lies outside the reference's 95 % interval. --write
replaces the reference. --films changes the number of films per scenario and disables the comparison. Films in 1080p
run only if named. --payload prints films with all codewords, payload per second of the packets in the films, and
processor time of the receiver per second of film instead.
"""

import argparse
import csv
import os
import sys
import tempfile
import time
import zlib
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before importing NumPy

import numpy as np

from benchmarks.scenarios import SCENARIOS, Film
from heliograph.base.frames import Frame
from heliograph.channel.truth import Truth
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import default_messages, simulate
from heliograph.link.truth import FrameTruth
from heliograph.measure.bench import block_settings, dithered, random_messages, window_margin_px
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.measure.statistics import clopper_pearson
from heliograph.media import create_film, open_film
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS
from heliograph.transmit import Messages

REFERENCE = Path(__file__).with_suffix(".csv")


class RenderedFilm:
    """Frames with ground truth in memory; a `FrameSource` and a `TruthSource`."""

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
    if film.mbit_s is not None:
        frames = compress(frames, settings, film.mbit_s)
    return RenderedFilm(frames, settings, messages)


def compress(
    frames: Sequence[tuple[Frame, FrameTruth]], settings: LinkSettings, mbit_s: float
) -> list[tuple[Frame, FrameTruth]]:
    """Write frames as H.264 and read them."""
    camera = settings.channel.camera
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "film.mp4"
        with create_film(path, width=camera.width, height=camera.height, rate_hz=camera.fps, mbit_s=mbit_s) as out:
            for frame, _ in frames:
                out.write(frame)
        with open_film(path) as film:
            return [(frame, replace(truth, index=frame.index)) for frame, (_, truth) in zip(film, frames, strict=True)]


def _frame_truth(truth: Truth) -> FrameTruth:
    return FrameTruth(
        truth.index, truth.time_s, [one.distance_m for one in truth.arrays], [one.visible for one in truth.arrays]
    )


FAULTS = ("undetected errors", "foreign packets")

Row = dict[str, int]


def count(name: str, number: int) -> dict[str, Row]:
    """Count sent and correct codewords per layer, undetected errors and false packets in a film, by receiver."""
    limit_threads()
    one = SCENARIOS[name]
    seed = zlib.crc32(f"{name} {number}".encode())
    rendered = render(one.draw(np.random.default_rng(seed), number), seed & 0xFFFF)
    rows = {}
    for receiver in one.receivers:
        settings = replace(rendered.settings, receive=replace(rendered.settings.receive, receiver=receiver))
        reception = ReceptionCounter(rendered)
        start_s = time.process_time()
        deque(receive_and_count(rendered, settings.signal, settings, reception), maxlen=0)
        decode_s = time.process_time() - start_s
        errors = reception.errors
        assert errors is not None  # ground truth is available
        row = {"undetected errors": errors.false_codewords, "foreign packets": errors.false_packets}
        for layer in LAYERS:
            counts = [layers[layer] for layers in errors.bins().values()]
            row[f"{layer} sent"] = sum(of.codewords for of in counts)
            row[f"{layer} right"] = sum(of.codewords - of.codeword_errors for of in counts)
        row |= measure_payload(rendered, errors.detected()[0], row) | {"decode ms": round(1000 * decode_s)}
        rows[receiver] = row
    return rows


def measure_payload(film: RenderedFilm, packets: int, row: Row) -> Row:
    """Return films with all codewords, payload in correct codewords, and durations of packets and film in ms."""
    signal, formats, times_s = film.settings.signal, film.settings.transmit.formats, [f.time_s for f in film]
    layers = PacketFormat(signal, *formats[:1]).layers
    return {
        "films": 1,
        "complete films": int(packets > 0 and all(row[f"{layer} sent"] == row[f"{layer} right"] for layer in LAYERS)),
        "payload bytes": sum(form.payload_bytes * row[f"{layer} right"] for layer, form in layers.items()),
        "packets ms": round(1000 * packets * signal.packet_s),
        "film ms": round(1000 * (times_s[-1] - times_s[0])),
    }


def run(names: Iterable[str], workers: int, count_films: int | None) -> Iterator[tuple[str, str, Row]]:
    """Yield summed counts for each scenario and receiver."""
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        films = {
            name: [pool.submit(count, name, k) for k in range(count_films or SCENARIOS[name].films)] for name in names
        }
        for name, done in films.items():
            for receiver in SCENARIOS[name].receivers:
                rows = [each.result()[receiver] for each in done]
                yield name, receiver, {key: sum(row[key] for row in rows) for key in rows[0]}


def read_reference() -> dict[tuple[str, str], Row]:
    """Read the reference by scenario and receiver."""
    with REFERENCE.open(newline="") as file:
        rows = list(csv.DictReader(file))
    return {(row.pop("scenario"), row.pop("receiver")): {key: int(n) for key, n in row.items()} for row in rows}


def differs(row: Row, before: Row) -> bool:
    """True if correct codewords lie outside the reference's 95 % interval, or undetected errors increased."""
    for layer in LAYERS:
        sent, right = before[f"{layer} sent"], before[f"{layer} right"]
        low, high = clopper_pearson(right, sent) if sent else (0.0, 1.0)
        now = row[f"{layer} right"] / max(row[f"{layer} sent"], 1)
        if row[f"{layer} sent"] != sent or not low <= now <= high:
            return True
    return row["undetected errors"] > before["undetected errors"]


def format_row(name: str, receiver: str, row: Row, before: Row) -> str:
    """Format a Markdown table row, with differing references in brackets."""

    def cell(right: str, sent: str | None = None) -> str:
        was = before.get(right, row[right])
        return f"{row[right]}{f'/{row[sent]}' if sent else ''}{'' if was == row[right] else f' ({was})'}"

    layers = [cell(f"{layer} right", f"{layer} sent") for layer in LAYERS]
    return f"| {name} | {receiver} | {' | '.join([*layers, *map(cell, FAULTS)])} |"


def format_payload(name: str, receiver: str, row: Row) -> str:
    """Format a Markdown table row of the payload."""
    right, sent = (sum(row[f"{layer} {part}"] for layer in LAYERS) for part in ("right", "sent"))
    rate = 1000 * row["payload bytes"] / max(row["packets ms"], 1)
    films, ratio = f"{row['complete films']}/{row['films']}", row["decode ms"] / max(row["film ms"], 1)
    return f"| {name} | {receiver} | {films} | {right}/{sent} | {rate:.0f} | {ratio:.2f} |"


def main() -> int:
    """Print the table; return 1 if a row differs from the reference."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenarios", nargs="*", metavar="SCENARIO", help="beginnings of names; default: all")
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--films", type=int, help="films of each scenario, instead of those of the reference")
    parser.add_argument("--payload", action="store_true")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    if given.write and given.films:
        parser.error("--write keeps the reference's own films: leave out --films")
    named = tuple(given.scenarios)
    names = [name for name in SCENARIOS if name.startswith(named or "") and (named or not name.startswith("1080p"))]
    reference = read_reference() if REFERENCE.exists() and not given.films else {}
    columns = (
        ["complete films", "codewords", "payload bytes/s", "decode s/film s"] if given.payload else [*LAYERS, *FAULTS]
    )
    print(f"| scenario | receiver | {' | '.join(columns)} |\n|{'---|' * (2 + len(columns))}")
    if given.payload:
        for name, receiver, row in run(names, given.workers, given.films):
            print(format_payload(name, receiver, row), flush=True)
        return 0
    found, total, outside = dict(reference), {"sent": 0, "right": 0, "before": 0}, []
    for name, receiver, row in run(names, given.workers, given.films):
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
