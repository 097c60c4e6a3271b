"""Fuzz each parser with damaged and random input: each case returns a value or raises a HeliographError."""

import argparse
import io
import json
import random
import signal
import warnings
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from fuzz_films import FRAMES_READ, MARK, Parser, Seeds, film_seeds

from heliograph.base.errors import HeliographError
from heliograph.base.toml_text import parse_assignment, parse_toml, to_toml
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.link.simulate import load_imu
from heliograph.link.truth import noted_signal, open_truth
from heliograph.media.record import FilmRecord
from heliograph.media.slots import SUFFIXES, SlotForm, open_slots, write_slots
from heliograph.road.codec import road_values, road_words
from heliograph.road.countdown import Countdown
from heliograph.signal.block import Block, pack, payload_bytes, unpack
from heliograph.signal.message import Reassembler
from heliograph.sweeps.plan import grid, parse_vary

LIMIT_S = 10.0
"""Time limit per case: a hundred times the time for a complete film."""

WORDS = [
    b"nan", b"inf", b"-1", b"0", b"1e308", b"1e-308", b"true", b"null", b"[", b"]", b"{", b"}", b'"', b"=", b".", b",",
    b":", b"\n", b"\x00", b"\xff", b"9" * 5000, b"[" * 3000, b"0x" + b"f" * 5000, b"a." * 500, b"1:1e9:1e-9",
    b"1e999999999", b"channel", b"signal.side", b"receive.receiver", b"1979-05-27", b"'''", b"\xe2\x80\xa8", b"frames",
    b"times_s",
]  # fmt: skip
"""Words inserted into texts."""

TRUTH_PARTS = ("about.json", "frames.npy", "messages/0/high/0", "messages/0/low/0")
"""Mutated parts of the truth file."""


def mutated(data: bytes, rng: random.Random) -> bytes:
    """Apply a few mutations: flipped bits, runs, inserted words, and removed, repeated or swapped parts."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3, 8))):
        place, length = rng.randrange(len(out) + 1), int(2 ** rng.uniform(0, 8))
        kind = rng.randrange(7)
        if kind == 0 and place < len(out):
            out[place] ^= 1 << rng.randrange(8)
        elif kind == 1 and place < len(out):
            out[place] = rng.choice((0, 1, 127, 128, 255))
        elif kind == 2:
            out[place : place + length] = rng.randbytes(len(out[place : place + length]))
        elif kind == 3:
            del out[place : place + length]
        elif kind == 4:
            out[place:place] = out[place : place + length]
        elif kind == 5:
            word = rng.choice(WORDS)
            out[place : place + rng.choice((0, len(word)))] = word
        else:
            out[place : place + 8] = rng.choice((0, 1, (1 << 63) - 1, (1 << 64) - 1, 1 << 32)).to_bytes(8, "little")
    return bytes(out) if rng.random() < 0.97 else bytes(out[: rng.randrange(len(out) + 1)])


def of_file(suffix: str, read: Callable[[Path], object]) -> Parser:
    def parse(data: bytes, folder: Path) -> object:
        path = folder / f"a{suffix}"
        path.write_bytes(data)
        return read(path)

    return parse


def of_text(read: Callable[[str], object]) -> Parser:
    return lambda data, _: read(data.decode(errors="replace"))


def read_truth(data: bytes, folder: Path) -> object:
    path = folder / "a.npz"
    path.write_bytes(data if data[:2] == b"PK" else packed(data))
    return sum(1 for _ in zip(open_truth(path).frames(), range(FRAMES_READ), strict=False))


def unpacked(path: Path) -> bytes:
    """Return the concatenated members of a truth file, so that mutations pass the archive's checksums."""
    with zipfile.ZipFile(path) as archive:
        return MARK.join(archive.read(name) for name in TRUTH_PARTS)


def packed(data: bytes) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for name, part in zip(TRUTH_PARTS, data.split(MARK), strict=False):
            archive.writestr(name, part)
    return out.getvalue()


def read_assignment(text: str) -> object:
    parse_assignment(text)
    return load_settings("static", None, [text])


def read_vary(text: str) -> object:
    return grid(dict([parse_vary(text)]))


def read_note(text: str) -> object:
    film: Any = argparse.Namespace(metadata={"heliograph_signal": text})
    return noted_signal(film)


def read_block(data: bytes, _: Path) -> object:
    body = data[:512].ljust(9, b"\0")
    bits = np.unpackbits(np.frombuffer(body + zlib.crc32(body).to_bytes(4), np.uint8))
    block = unpack(bits)
    return block and Reassembler().add(block, payload_bytes(bits.size))


def read_road(data: bytes, _: Path) -> object:
    values = road_values(data)
    if values is not None:
        Countdown().take(values, 1.0)
        return road_words(values)
    return None


def seeds(folder: Path) -> Seeds:
    """Return parsers with valid inputs, by name."""
    small = ["channel.camera.width=64", "channel.camera.height=32", "channel.duration_s=0.02"]
    settings = load_settings("static", None, small)
    write_film(folder / "a.h5", settings, [{"high": [b"kept"], "low": [b"more"]}], seed=1)
    truth = folder / "a.h5.truth.npz"
    note = json.dumps(asdict(settings.signal))
    slots = np.random.default_rng(0).integers(0, 2, (12, 8, 8), dtype=np.uint8)
    found = film_seeds(folder, note)
    for suffix in SUFFIXES:
        path = folder / f"c{suffix}"
        write_slots(path, slots, SlotForm(8, 4, 250_000, len(slots)))
        found[f"slots{suffix}"] = of_file(suffix, lambda path: list(open_slots(path))), [path.read_bytes()]
    trees = [to_toml(asdict(load_settings(name))).encode() for name in ("paper", "two-arrays")]
    keys = [b"channel.distance_m=60", b"channel.arrays.0.x_m=1.5", b"signal.rate.high=1/2", b"receive.receiver='soft'",
            b"channel.arrays=[{x_m=1}]", b"transmit.identities=[3]", b"channel.speed_profile=[[0, 3]]"]  # fmt: skip
    ranges = [b"channel.distance_m=10,25:120:5", b"receiver=plain,soft", b"preset=paper", b"signal.side=[1,2],{a=1}"]
    record = FilmRecord(rate_hz=1000.0, bits=8, start_s=0.0, metadata={"a": "b"})
    rows = [b"t_s,gyro_fwd_rad_s,gyro_right,gyro_down,speed_m_s"] + [b"%f,0,0.1,0,8" % (k / 50) for k in range(40)]
    block = pack(Block("high", 3, 1, 0, 4, b"kept"), 8 * 40)
    return found | {
        "truth": (read_truth, [truth.read_bytes(), unpacked(truth)]),
        "trace": (of_file(".csv", load_imu), [b"\n".join(rows)]),
        "settings": (of_text(lambda text: load_settings("paper", parse_toml(text))), trees),
        "set": (of_text(read_assignment), keys),
        "vary": (of_text(read_vary), ranges),
        "record": (of_text(FilmRecord.loads), [record.dumps().encode()]),
        "note": (of_text(read_note), [note.encode()]),
        "block": (read_block, [np.packbits(block).tobytes()[:-4]]),
        "road": (read_road, [bytes.fromhex(one) for one in ROAD]),
    }


ROAD = (
    "01040000000700180003810000003e875300000104340269026900",
    "01040000000700180003810000354300bb8010011434003c003c226001e002300230008515000b400b4918005a00780078",
)
"""Two SPATEMs, with one and two lights; the second includes the next phases."""


class _Late(BaseException):
    """Raised if a case exceeds `LIMIT_S`; a BaseException, so that parsers do not catch it."""


def _late(*_: object) -> None:
    raise _Late


def outcome(parser: Parser, data: bytes, folder: Path) -> str:
    """Run a case; return "value", "error", or a fault description."""
    before = signal.signal(signal.SIGALRM, _late)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            parser(data, folder)
    except HeliographError as error:
        return "error" if "\n" not in str(error) and len(str(error)) < 2000 else "a long message"
    except _Late:
        return f"more than {LIMIT_S:g} s"
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:90]}"
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    return "value"
