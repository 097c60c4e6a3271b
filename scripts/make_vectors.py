"""Write the worked examples of the air interface, docs/vectors/*.json.

    python scripts/make_vectors.py

Every file has a field "about" that says what it is. Bits are strings of 0 and 1, first bit first; bytes are
hexadecimal; a pattern is a list of rows, top row first, each a string of levels 0 to 4, left LED first.
"""

import hashlib
import json
import zlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.signal import haar, pwm
from heliograph.signal.block import Block, pack
from heliograph.signal.formats import SHORT_PAIRS, Format, format_of, words
from heliograph.signal.fountain.cauchy import CauchyEncoder
from heliograph.signal.fountain.files import FileCarousel, SentFile
from heliograph.signal.header import IDENTITIES, header_cells, header_levels, identity, signalling_levels
from heliograph.signal.m_sequence import m_sequence
from heliograph.signal.packet import PacketFormat, whitening
from heliograph.signal.settings import LAYERS, RateSettings, SignalSettings
from heliograph.signal.turbo import TurboCode
from heliograph.transmit import Transmitter

FOLDER = Path(__file__).parents[1] / "docs" / "vectors"

Vector = dict[str, Any]

MESSAGES = {
    "high": [b"Heliograph", b"A second message of the high layer, on stream 1."],
    "middle": [b"Middle priority: " + bytes(range(32, 127)) * 2],
}
"""The low layer has none: it sends idle blocks."""


def digits(values: Iterable[Any]) -> str:
    return "".join(str(int(value)) for value in values)


def rows(matrix: NDArray[Any]) -> list[str]:
    return [digits(row) for row in matrix]


def signs(matrix: NDArray[Any]) -> list[str]:
    return ["".join("+" if value > 0 else "-" for value in row) for row in matrix]


def bits_of(text: bytes, count: int) -> NDArray[np.uint8]:
    return np.unpackbits(np.frombuffer(text, dtype=np.uint8))[:count]


def to_hex(bits: NDArray[np.uint8]) -> str:
    return np.packbits(bits).tobytes().hex()


def haar_vector() -> Vector:
    def case(d: NDArray[np.int8]) -> Vector:
        levels = haar.encode(d)
        return {"d": signs(d), "levels": rows(levels), "inverse": rows(pwm.invert(levels))}

    two = [np.array([[a, b], [c, d]], np.int8) for a in (1, -1) for b in (1, -1) for c in (1, -1) for d in (1, -1)]
    text = hashlib.sha512(b"Heliograph").digest()
    larger = [(1 - 2 * bits_of(text, n * n).astype(np.int8)).reshape(n, n) for n in (4, 16)]
    return {
        "about": "Data matrices D (+ is +1, - is -1), their patterns of levels and the inverted patterns: all of side "
        "2, one of side 4, one of side 16.",
        "cases": [case(d) for d in [*two, *larger]],
    }


def header_vector() -> Vector:
    def case(number: int) -> Vector:
        polynomial, phase = identity(number)
        chips = np.roll(m_sequence(polynomial), -phase)
        cells = header_cells(number)
        return {
            "identity": number,
            "polynomial": f"{polynomial:05b}",
            "phase": phase,
            "chips": digits(chips),
            "cells": rows(cells > 0),
            "levels_side_8": rows(header_levels(number, 8)),
        }

    return {
        "about": "Headers of identities 0, 7 and 15: the 15 chips in the order of the path, the 4 x 4 cells (1 lit), "
        "the pattern of a 8 x 8 array; and the cells of all identities, rows joined by /.",
        "cases": [case(number) for number in (0, 7, 15)],
        "all_cells": ["/".join(rows(header_cells(number) > 0)) for number in range(IDENTITIES)],
    }


def formats_vector() -> Vector:
    def case(number: int) -> Vector:
        named = format_of(number)
        return {
            "format": number,
            "mode": named.mode,
            "rate": [named.high, named.middle, named.low],
            "word": rows(words()[number].reshape(4, 4)),
            "levels_side_8": rows(signalling_levels(7, number, 8)),
        }

    return {
        "about": "Formats: mode, rates of the high, middle and low layer (null for the agreed one), the word by cell "
        "(1 has half the contrast), and the later header pairs' pattern of identity 7 on a 8 x 8 array.",
        "cases": [case(number) for number in (0, 1, 0o12, 0o123, 0o765, 0o1000, 0o1765, 0o2000, 0o2222)],
    }


def block_vector() -> Vector:
    def case(block: Block, k: int) -> Vector:
        fields = {name: getattr(block, name) for name in ("layer", "identity", "stream", "sequence", "length")}
        return {**fields, "payload": block.payload.hex(), "k": k, "block": to_hex(pack(block, k))}

    return {
        "about": "Blocks: fields, payload before filling, information bits K, and the block as sent, CRC included.",
        "cases": [
            case(Block("high", 0, 0, 0, 1, b"\x55"), 104),
            case(Block("high", 7, 0, 0, 10, b"Heliograph"), 1024),
            case(Block("middle", 29, 255, 65535, (1 << 24) - 1, bytes(range(20))), 256),
            case(Block("low", 7, 0, 0, 0, b""), 1024),
        ],
    }


def files_vector() -> Vector:
    file = SentFile("map.txt", b"Heliograph sends whole files.")
    encoder = CauchyEncoder(file.packed, 8)
    blocks, small = (FileCarousel(7, "low", [file], [k]) for k in (336, 136))

    def case(number: int) -> Vector:
        return {"number": number, "symbol": encoder.symbol(number).hex()}

    return {
        "about": "A file by the Cauchy code: name, content, both as they are sent, symbols of 8 bytes by number, and "
        "blocks of K = 336 information bits whose symbols have as many bytes as find room, and small blocks of K = "
        "136, of which number 4 tells what the file is.",
        "name": file.name,
        "content": file.data.hex(),
        "sent": file.packed.hex(),
        "size": 8,
        "check": f"{zlib.crc32(file.packed):08x}",
        "symbols": [case(number) for number in (0, encoder.count - 1, encoder.count, 6, 300, 65535)],
        "blocks": [to_hex(pack(blocks.block(number, 336), 336)) for number in range(4)],
        "small_blocks": [to_hex(pack(small.block(number, 136), 136)) for number in range(10)],
    }


def turbo_vector() -> Vector:
    def case(k: int, e: int) -> Vector:
        bits = bits_of(b"".join(hashlib.sha256(bytes([i])).digest() for i in range(8)), k)
        mother = TurboCode(k=k).encode(bits).reshape(-1, 3).T
        sent = TurboCode(k=k, coded_bits=e).encode(bits)
        return {"k": k, "e": e, "bits": digits(bits), "d0_d1_d2": rows(mother), "sent": digits(sent)}

    return {
        "about": "Turbo code: K information bits, the streams d0, d1, d2 of K + 4 bits, the E bits sent after rate "
        "matching (punctured, about whole, repeated).",
        "cases": [case(40, 132), case(104, 116), case(112, 336), case(512, 1600), case(1024, 3072)],
    }


def whitening_vector() -> Vector:
    places = [(layer, codeword) for layer in LAYERS for codeword in (0, 1)]
    return {
        "about": "Whitening: the first 64 chips of the layers' codewords 0 and 1 of a packet.",
        "cases": [{"layer": n, "codeword": i, "chips": digits(whitening(64, n, i))} for n, i in places],
    }


def interleaver_vector() -> Vector:
    def case(settings: SignalSettings, name: str, count: int) -> Vector:
        layer = PacketFormat(settings).layers[name]
        places = layer.places[:count]
        return {
            "layer": name,
            "side": settings.side,
            "data_pairs": layer.pairs,
            "cells": layer.symbols,
            "codewords": layer.codewords,
            "k": layer.code.k,
            "e": layer.code.length,
            "pair_of_j": (places // layer.symbols).tolist(),
            "cell_of_j": (places % layer.symbols).tolist(),
        }

    small, default = SignalSettings(side=8, data_pairs=21), SignalSettings()
    return {
        "about": "Interleaver: data pair and cell of coded bit j = 0, 1, 2 ... of a layer (codewords one after the "
        "other); the first 200 bits.",
        "cases": [case(s, name, 200) for s in (small, default) for name in ("high", "middle")],
    }


def packet_case(settings: SignalSettings, identity_number: int) -> tuple[Vector, NDArray[np.uint8]]:
    sender = Transmitter(settings, identity_number, MESSAGES)
    layers = {
        name: {
            "codewords": layer.codewords,
            "k": layer.code.k,
            "e": layer.code.length,
            "messages": [text.hex() for text in MESSAGES.get(name, [])],
            "blocks": [to_hex(pack(block, layer.code.k)) for block in sender.blocks(0)[name]],
        }
        for name, layer in sender.format.layers.items()
    }
    made = next(sender.packets())
    head = {
        "identity": identity_number,
        "side": settings.side,
        "header_pairs": settings.header_pairs,
        "data_pairs": settings.data_pairs,
        "rate": [settings.rate.high, settings.rate.middle, settings.rate.low],
        "modulation": settings.modulation,
        "layers": layers,
        "sha256": hashlib.sha256(made.tobytes()).hexdigest(),
    }
    return head, made


def small_packet() -> Vector:
    rate = RateSettings(high=1 / 3, middle=0.5, low=0.75)
    head, made = packet_case(SignalSettings(side=8, header_pairs=1, data_pairs=21, rate=rate), 15)
    return {
        "about": "Packet 0 of a carousel on a 8 x 8 array, complete; the sha256 is of all levels as bytes, patterns "
        "in the order of time, rows from the top, LEDs from the left.",
        **head,
        "patterns": [rows(pattern) for pattern in made],
    }


def named_packets(formats: Sequence[Format], count: int, shown: int, pairs: int = 21) -> Vector:
    """Packets of a carousel that take formats in turn, the first patterns of each in full."""
    settings = SignalSettings(side=8, header_pairs=2, data_pairs=pairs)
    sender = Transmitter(settings, 15, MESSAGES, formats)
    packets = sender.packets()

    def case(number: int) -> Vector:
        form, made = sender.format_of(number), next(packets)
        blocks = {
            name: [to_hex(pack(block, form.layers[name].code.k)) for block in sent]
            for name, sent in sender.blocks(number).items()
        }
        return {
            "format": form.format.number,
            "blocks": blocks,
            "patterns": ["/".join(rows(pattern)) for pattern in made[:shown]],
            "sha256": hashlib.sha256(made.tobytes()).hexdigest(),
        }

    return {
        "identity": 15,
        "side": settings.side,
        "header_pairs": settings.header_pairs,
        "data_pairs": settings.data_pairs,
        "rate": [1 / 3] * 3,
        "modulation": settings.modulation,
        "messages": {name: [text.hex() for text in MESSAGES.get(name, [])] for name in LAYERS},
        "packets": [case(number) for number in range(count)],
    }


def formats_packet() -> Vector:
    return {
        "about": "Packets 0, 1 and 2 of a carousel on a 8 x 8 array whose packets take two formats in turn: the "
        "blocks, header and first data pair, and the sha256 of all levels as bytes as in packet_small.json.",
        **named_packets((Format(middle=0.5, low=0.9), Format(high=0.75)), 3, 6),
    }


def single_packet() -> Vector:
    return {
        "about": "Packets 0 and 1 of the single mode on a 8 x 8 array, all patterns, rows joined by /; the polarities "
        "are those of section 6.3's rule, the sum of D11 being 0 before packet 0.",
        **named_packets((Format(mode="single", high=0.5, middle=0.75, low=0.9),), 2, 46),
    }


def short_packet() -> Vector:
    return {
        "about": "Packets 0 and 1 of the short mode on a 8 x 8 array, all patterns, rows joined by /.",
        **named_packets((Format(mode="short", high=0.5, middle=0.5, low=0.5),), 2, 30, SHORT_PAIRS),
    }


def ook_packet() -> Vector:
    head, made = packet_case(SignalSettings(side=4, header_pairs=1, data_pairs=84, modulation="ook"), 3)
    return {
        "about": "Packet 0 on a 4 x 4 array with on-off keying; all patterns, rows joined by /.",
        **head,
        "patterns": ["/".join(rows(pattern)) for pattern in made],
    }


def default_packet() -> Vector:
    head, made = packet_case(SignalSettings(), 7)
    return {
        "about": "Packet 0 with the default settings: the sha256 is of all levels as bytes, as in packet_small.json; "
        "the header pair, the first two data pairs and the last one in full.",
        **head,
        "patterns": {str(i): rows(made[i]) for i in (0, 1, 4, 5, 6, 7, 98, 99)},
    }


def vectors() -> dict[str, str]:
    """Text of each file by name."""
    made = {
        "haar": haar_vector(),
        "header": header_vector(),
        "formats": formats_vector(),
        "block": block_vector(),
        "files": files_vector(),
        "turbo": turbo_vector(),
        "whitening": whitening_vector(),
        "interleaver": interleaver_vector(),
        "packet_small": small_packet(),
        "packet_formats": formats_packet(),
        "packet_single": single_packet(),
        "packet_short": short_packet(),
        "packet_ook": ook_packet(),
        "packet_default": default_packet(),
    }
    return {f"{name}.json": compact(vector) for name, vector in made.items()}


def compact(vector: Vector) -> str:
    """JSON with a line for each field of the file and each item of a list in it."""
    lines = []
    for key, value in vector.items():
        if isinstance(value, list):
            text = "[\n" + ",\n".join(f"  {json.dumps(item)}" for item in value) + "\n ]"
        elif isinstance(value, dict):
            text = "{\n" + ",\n".join(f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in value.items()) + "\n }"
        else:
            text = json.dumps(value)
        lines.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(lines) + "\n}\n"


if __name__ == "__main__":
    FOLDER.mkdir(parents=True, exist_ok=True)
    for name, text in vectors().items():
        (FOLDER / name).write_text(text, encoding="utf-8")
        print(f"{name}: {len(text)} bytes")
