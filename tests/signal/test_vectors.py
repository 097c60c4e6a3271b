"""Published vectors against the package and a pure Python implementation from docs/air-interface.md and its tables."""

import hashlib
import json
import re
import runpy
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from heliograph.signal.turbo import QPP_SIZES

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "docs" / "vectors"
DOCUMENT = (ROOT / "docs" / "air-interface.md").read_text(encoding="utf-8")
LAYERS = ["high", "middle", "low"]
Matrix = list[list[int]]
QPP = {int(k): (int(f1), int(f2)) for k, f1, f2 in re.findall(r"(\d+): (\d+) (\d+)", DOCUMENT)}
RATES = [float(Fraction(r)) for r in re.findall(r"\d+/\d+", re.findall(r"(?m)^   \| rate \|.*$", DOCUMENT)[0])]
COLUMNS = [int(c) for c in re.findall(r"T = ([\d ]+)", DOCUMENT)[0].split()]


def header(identity: int) -> Matrix:
    """Section 4: cells, 1 lit."""
    q, s = divmod(identity, 15)
    a = [1, 0, 0, 0]
    while len(a) < 15:
        a.append(a[-1] ^ a[-4] if q == 0 else a[-3] ^ a[-4])
    path = [0, 1, 2, 3, 7, 6, 5, 4, 8, 9, 10, 11, 15, 14, 13, 12]
    chips = [a[(k + s) % 15] for k in range(15)] + [0]
    return [[chips[path[4 * r + c]] for c in range(4)] for r in range(4)]


def header_pattern(identity: int, n: int) -> Matrix:
    cells = header(identity)
    return [[4 * cells[u * 4 // n][v * 4 // n] for v in range(n)] for u in range(n)]


def word(form: int) -> Matrix:
    """Section 4.1: word per cell."""
    f, cells = [form >> bit & 1 for bit in range(11)], []
    for i in range(4):
        v2, v3, row = i % 2, i // 2, []
        for j in range(4):
            v0, v1 = j % 2, j // 2
            linear = f[0] + f[1] * v0 + f[2] * v1 + f[3] * v2 + f[4] * v3
            products = f[5] * v0 * v1 + f[6] * v0 * v2 + f[7] * v0 * v3 + f[8] * v1 * v2 + f[9] * v1 * v3
            row.append((linear + products + f[10] * v2 * v3) % 2)
        cells.append(row)
    return cells


def dimmed_pattern(identity: int, form: int, n: int) -> Matrix:
    """Section 4.1: later header pairs."""
    dim, full, r = word(form), header_pattern(identity, n), range(n)
    return [[{0: 1, 4: 3}[full[u][v]] if dim[u * 4 // n][v * 4 // n] else full[u][v] for v in r] for u in r]


def inverse(pattern: Matrix) -> Matrix:
    """Section 3."""
    return [[4 - level for level in row] for row in pattern]


def haar(d: Matrix) -> Matrix:
    """Section 6.1: levels."""
    n, h = len(d), len(d) // 2

    def level(u: int, v: int) -> int:
        i, j = u // 2, v // 2
        across, down = 1 - v % 2 * 2, 1 - u % 2 * 2
        return 2 + (d[i][j] + across * d[i][h + j] + down * d[h + i][j] + down * across * d[h + i][h + j]) // 2

    return [[level(u, v) for v in range(n)] for u in range(n)]


def ook(d: Matrix) -> Matrix:
    """Section 6.2."""
    return [[4 if value > 0 else 0 for value in row] for row in d]


def crc32(data: bytes) -> int:
    """Section 7: bit by bit, reflected."""
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0xEDB88320 if register & 1 else 0)  # 0xEDB88320 is 0x04C11DB7 bit-reversed
    return register ^ 0xFFFFFFFF


def sealed(body: bytes, k: int) -> bytes:
    """Section 7: padding and check sum."""
    body += bytes(k // 8 - 4 - len(body))
    return body + crc32(body).to_bytes(4, "big")


def block(layer: str, identity: int, stream: int, sequence: int, length: int, payload: bytes, k: int) -> bytes:
    """Section 7."""
    head = bytes([16 + LAYERS.index(layer), identity, stream]) + sequence.to_bytes(2, "big") + length.to_bytes(3, "big")
    return sealed(head + payload, k)


def product(a: int, b: int) -> int:
    """Section 8.1: product in GF(2^16)."""
    out = 0
    for bit in range(16):
        out ^= a * (b >> bit & 1)
        a = a << 1 ^ (0x1100B if a >> 15 else 0)
    return out


def reciprocal(a: int) -> int:
    """Return a^(2^16 - 2)."""
    out, square = 1, a
    for _ in range(15):
        square = product(square, square)
        out = product(out, square)
    return out


def symbol(sent: bytes, size: int, number: int) -> bytes:
    """Section 8.1, code 0."""
    k = -(-len(sent) // size)
    sent = sent.ljust(k * size, b"\0")
    if number < k:
        return sent[number * size : (number + 1) * size]
    made = b""
    for place in range(0, size, 2):
        y = 0
        for j in range(k):
            y ^= product(int.from_bytes(sent[j * size + place : j * size + place + 2], "big"), reciprocal(number ^ j))
        made += bytes([y >> 8, y & 255])
    return made


def file_block(sent: bytes, number: int, size: int, k: int) -> bytes:
    """Section 7.1, array 7, low layer."""
    head = bytes([16 + 4 + 2, 7, 0]) + number.to_bytes(3, "big") + len(sent).to_bytes(3, "big")
    head += size.to_bytes(2, "big") + crc32(sent).to_bytes(4, "big")
    return sealed(head + b"".join(symbol(sent, size, number + i) for i in range((k // 8 - 19) // size)), k)


def small_file_block(sent: bytes, number: int, size: int, k: int, notice: bool) -> bytes:
    """Section 7.2, array 7, low layer."""
    check = crc32(sent).to_bytes(4, "big")
    if notice:
        return sealed(bytes([16 + 12 + 2, 7]) + len(sent).to_bytes(3, "big") + check, k)
    return sealed(bytes([16 + 8 + 2, 7, check[0]]) + number.to_bytes(2, "big") + symbol(sent, size, number), k)


def carousel(layer: str, identity: int, messages: list[bytes], k: int) -> list[bytes]:
    """Section 8: all segments in order."""
    room = k // 8 - 12
    return [
        block(layer, identity, stream, i, len(text), text[i * room : (i + 1) * room], k)
        for stream, text in enumerate(messages or [b""])
        for i in range(max(1, -(-len(text) // room)))
    ]


def plan(h: int, pairs: int, quarters: int, rate: float, column: int = 0) -> tuple[int, int, int]:
    """Section 9.1: W, K and E; `column` is 1 for the high layer of the single mode."""
    bits = h * (h - column) * pairs
    m = next(m for m in range(1, bits + 1) if bits % m == 0 and rate * (bits // m) <= 6176)
    e = bits // m
    k = min((k for k in QPP if 10 * k <= 9 * e), key=lambda k: (abs(k - rate * e), k))
    return quarters * m, k, e


def constituent(c: list[int]) -> tuple[list[int], list[int]]:
    """Section 9.2: inputs and parities for K + 3 steps."""
    w, x, z = [0, 0, 0], [], []
    for step in range(len(c) + 3):
        feedback = w[-2] ^ w[-3]
        x.append(c[step] if step < len(c) else feedback)
        z.append(x[-1] ^ feedback ^ w[-1] ^ w[-3])
        w.append(x[-1] ^ feedback)
    assert w[-3:] == [0, 0, 0]
    return x, z


def mother(c: list[int]) -> list[list[int]]:
    """Section 9.2: d0, d1, d2."""
    k = len(c)
    f1, f2 = QPP[k]
    x, z = constituent(c)
    y, t = constituent([c[(f1 * i + f2 * i * i) % k] for i in range(k)])
    return [
        [*c, x[k], z[k + 1], y[k], t[k + 1]],
        [*z[:k], z[k], x[k + 2], t[k], y[k + 2]],
        [*t[:k], x[k + 1], z[k + 2], y[k + 1], t[k + 2]],
    ]


def rate_match(d: list[list[int]], e: int) -> list[int]:
    """Section 9.3; None marks a dummy position."""
    rows = -(-len(d[0]) // 32)
    size = 32 * rows
    y = [[None] * (size - len(stream)) + stream for stream in d]
    reading = [COLUMNS[k // rows] + 32 * (k % rows) for k in range(size)]
    v0, v1 = ([y[i][place] for place in reading] for i in (0, 1))
    v2 = [y[2][(place + 1) % size] for place in reading]
    buffer = v0 + [bit for two in zip(v1, v2, strict=True) for bit in two]
    sent: list[int] = []
    place = 2 * rows
    while len(sent) < e:
        bit = buffer[place % len(buffer)]
        if bit is not None:
            sent.append(bit)
        place += 1
    return sent


def chips() -> list[int]:
    """Section 10: one period."""
    g = [1] * 15
    while len(g) < 32767:
        g.append(g[-1] ^ g[-15])
    return g


G = chips()


def whitening(count: int, layer: int, codeword: int) -> list[int]:
    return [G[(8192 * layer + 509 * codeword + j) % 32767] for j in range(count)]


def place(j: int, pairs: int, cells: int) -> tuple[int, int]:
    """Section 11."""
    pair = j % pairs
    return pair, (j // pairs + 23 * pair) % cells


def cell_of(layer: int, c: int, h: int) -> tuple[int, int]:
    """Section 5: row and column in D."""
    row, column = c % (h * h) // h, c % h
    if layer == 0:
        return row, column
    if layer == 2:
        return h + row, h + column
    return (row, h + column) if c < h * h else (h + row, column)


def balanced(data: list[list[list[int]]], ahead: int) -> list[Matrix]:
    """Section 6.3: return D11 per pattern from rows with h - 1 data."""
    found = []
    for rows in data:
        ahead += sum(rows[0])
        sums, polarity = [1 + sum(row) for row in rows], [1] * len(rows)
        for i in sorted(range(1, len(rows)), key=lambda i: (-abs(sums[i]), i)):
            polarity[i] = -1 if ahead * sums[i] > 0 else 1
            ahead += polarity[i] * sums[i]
        free = -1 if ahead > 0 else 1
        ahead += free
        signed = zip(polarity, rows, strict=True)
        found.append([[s if i else free, *(s * d for d in row)] for i, (s, row) in enumerate(signed)])
    return found


def blocks_of(case: dict[str, Any], forms: Sequence[int] = (0,), number: int = 0) -> list[list[bytes]]:
    """Section 8: return blocks per layer for packet `number`, with formats in rotation."""
    form, found = forms[number % len(forms)], []
    for layer, name in enumerate(LAYERS):
        sizes = [sizes_of(case, one, layer) for one in forms]
        words, k, _ = sizes[forms.index(form)]
        before = sum(sizes[p % len(forms)][0] for p in range(number) if sizes[p % len(forms)][1] == k)
        wheel = carousel(name, case["identity"], messages_of(case, name), k)
        found.append([wheel[(before + i) % len(wheel)] for i in range(words)])
    return found


def sizes_of(case: dict[str, Any], form: int, layer: int) -> tuple[int, int, int]:
    """Section 9.1: return W, K and E for a layer and format."""
    single, rate = form >> 9 == 1, rates_of(case, form)[layer]
    assert form >> 9 != 2 or case["data_pairs"] == 13
    pairs = case["data_pairs"] * (1 + single)
    return plan(case["side"] // 2, pairs, (1, 2, 1)[layer], rate, column=int(single and layer == 0))


def messages_of(case: dict[str, Any], name: str) -> list[bytes]:
    own = case["messages"][name] if "messages" in case else case["layers"][name]["messages"]
    return [bytes.fromhex(text) for text in own]


def rate_codes(form: int) -> list[int]:
    return [form >> place & 7 for place in (6, 3, 0)]


def rates_of(case: dict[str, Any], form: int) -> list[float]:
    """Section 4.1: rates for the high, middle and low layer."""
    codes = rate_codes(form)
    return [RATES[code - 1] if code else agreed for code, agreed in zip(codes, case["rate"], strict=True)]


def packet(case: dict[str, Any], forms: Sequence[int] = (0,), number: int = 0) -> list[Matrix]:
    """Section 12; in single mode, earlier packets use the same mode."""
    n, form = case["side"], forms[number % len(forms)]
    single = form >> 9 == 1
    h, pairs = n // 2, case["data_pairs"] * (1 + single)
    d = [[[0] * n for _ in range(n)] for _ in range(pairs)]
    for layer, sent in enumerate(blocks_of(case, forms, number)):
        _, _, e = sizes_of(case, form, layer)
        for i, one in enumerate(sent):
            coded = rate_match(mother([byte >> 7 - i & 1 for byte in one for i in range(8)]), e)
            for j, (bit, chip) in enumerate(zip(coded, whitening(e, layer, i), strict=True)):
                pair, cell = place(i * e + j, pairs, (h * (h - single), 2 * h * h, h * h)[layer])
                row, column = (cell // (h - 1), 1 + cell % (h - 1)) if single and not layer else cell_of(layer, cell, h)
                d[pair][row][column] = 1 - 2 * (bit ^ chip)
    modulate = haar if case["modulation"] == "haar" else ook
    head = [header_pattern(case["identity"], n)]
    head += [dimmed_pattern(case["identity"], form, n)] * (case["header_pairs"] - 1)
    if not single:
        return [both for pattern in head + [modulate(matrix) for matrix in d] for both in (pattern, inverse(pattern))]
    ahead = sum(2 * sum(map(sum, p)) - 4 * n * n for p in packet(case, forms, number - 1)) // 4 if number else 0
    d11 = balanced([[row[1:h] for row in matrix[:h]] for matrix in d], ahead)
    for matrix, quarter in zip(d, d11, strict=True):
        for row, new in zip(matrix, quarter, strict=False):
            row[:h] = new
    return [both for pattern in head for both in (pattern, inverse(pattern))] + [haar(matrix) for matrix in d]


def load(name: str) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    return found


def text_rows(matrix: Matrix) -> list[str]:
    return ["".join(map(str, row)) for row in matrix]


def digits(bits: list[int]) -> str:
    return "".join(map(str, bits))


def digest(patterns: list[Matrix]) -> str:
    return hashlib.sha256(bytes(level for pattern in patterns for row in pattern for level in row)).hexdigest()


def test_committed_files_match_the_code() -> None:
    made: dict[str, str] = runpy.run_path(str(ROOT / "scripts" / "make_vectors.py"))["vectors"]()
    assert {path.name for path in FOLDER.glob("*.json")} == set(made)
    for name, text in made.items():
        same = (FOLDER / name).read_text(encoding="utf-8") == text  # avoid pytest's diff over thousands of digits
        assert same, f"docs/vectors/{name} is out of date; run scripts/make_vectors.py"
        assert json.loads(text)["about"]
    assert sum(map(len, made.values())) < 200_000
    assert all(f"`{name}`" in DOCUMENT for name in made)


def test_tables_of_the_document() -> None:
    assert (tuple(QPP), sorted(COLUMNS)) == (QPP_SIZES, list(range(32)))
    drawn = ["/".join("".join(".#"[chip] for chip in row) for row in header(i)) for i in range(30)]
    # three groups with four lines, each with ten cells
    lines = [line.split() for line in re.findall(r"(?m)^(?: +[#.]{4}){10}$", DOCUMENT)]
    assert ["/".join(lines[first + r][i] for r in range(4)) for first in (0, 4, 8) for i in range(10)] == drawn


def haar_fields(case: dict[str, Any]) -> dict[str, Any]:
    levels = haar([[1 if sign == "+" else -1 for sign in row] for row in case["d"]])
    return {"levels": text_rows(levels), "inverse": text_rows(inverse(levels))}


def format_fields(case: dict[str, Any]) -> dict[str, Any]:
    rates = [RATES[code - 1] if code else None for code in rate_codes(case["format"])]
    dimmed = dimmed_pattern(7, case["format"], 8)
    return {"rate": rates, "word": text_rows(word(case["format"])), "levels_side_8": text_rows(dimmed)}


def block_fields(case: dict[str, Any]) -> dict[str, Any]:
    numbers = (case["identity"], case["stream"], case["sequence"], case["length"])
    return {"block": block(case["layer"], *numbers, bytes.fromhex(case["payload"]), case["k"]).hex()}


def turbo_fields(case: dict[str, Any]) -> dict[str, Any]:
    streams = mother([int(bit) for bit in case["bits"]])
    return {"d0_d1_d2": [digits(stream) for stream in streams], "sent": digits(rate_match(streams, case["e"]))}


def interleaver_fields(case: dict[str, Any]) -> dict[str, Any]:
    places = [place(j, case["data_pairs"], case["cells"]) for j in range(len(case["pair_of_j"]))]
    return {"pair_of_j": [pair for pair, _ in places], "cell_of_j": [cell for _, cell in places]}


FIELDS: dict[str, Callable[[dict[str, Any]], dict[str, Any]]] = {
    "haar": haar_fields,
    "header": lambda case: {"levels_side_8": text_rows(header_pattern(case["identity"], 8))},
    "formats": format_fields,
    "block": block_fields,
    "turbo": turbo_fields,
    "whitening": lambda case: {"chips": digits(whitening(64, LAYERS.index(case["layer"]), case["codeword"]))},
    "interleaver": interleaver_fields,
}


@pytest.mark.parametrize("name", FIELDS)
def test_vectors_follow_the_document(name: str) -> None:
    for case in load(name)["cases"]:
        assert not [key for key, value in FIELDS[name](case).items() if value != case[key]]


def test_header_and_check_sum() -> None:
    assert ["/".join(text_rows(header(i))) for i in range(30)] == load("header")["all_cells"]
    assert crc32(b"123456789") == 0xCBF43926


@pytest.mark.parametrize(("name", "count"), [("packet_formats", 2), ("packet_single", 1), ("packet_short", 1)])
def test_packets_that_name_their_format(name: str, count: int) -> None:
    case = load(name)
    forms = [sent["format"] for sent in case["packets"][:count]]
    assert len(set(forms)) == count
    for number, sent in enumerate(case["packets"]):
        assert sent["format"] == forms[number % count]
        expected = blocks_of(case, forms, number)
        assert [[bytes.fromhex(one) for one in sent["blocks"][name]] for name in LAYERS] == expected
        patterns = packet(case, forms, number)
        assert ["/".join(text_rows(pattern)) for pattern in patterns[: len(sent["patterns"])]] == sent["patterns"]
        assert digest(patterns) == sent["sha256"]


def test_files() -> None:
    vector = load("files")
    name, content = vector["name"].encode(), bytes.fromhex(vector["content"])
    sent = bytes([len(name)]) + name + content
    assert (sent.hex(), f"{crc32(sent):08x}") == (vector["sent"], vector["check"])
    for case in vector["symbols"]:
        assert symbol(sent, vector["size"], case["number"]).hex() == case["symbol"]
    assert [file_block(sent, number, 22, 336).hex() for number in range(4)] == vector["blocks"]
    for number, made in enumerate(vector["small_blocks"]):
        assert small_file_block(sent, number, 8, 136, notice=number == 4).hex() == made


@pytest.mark.parametrize("name", ["packet_small", "packet_ook", "packet_default"])
def test_packet(name: str) -> None:
    case = load(name)
    patterns = packet(case)
    for layer, rate in zip(LAYERS, case["rate"], strict=True):
        own = case["layers"][layer]
        sizes = plan(case["side"] // 2, case["data_pairs"], 2 if layer == "middle" else 1, rate)
        assert (own["codewords"], own["k"], own["e"]) == sizes
        wheel = carousel(layer, case["identity"], [bytes.fromhex(text) for text in own["messages"]], own["k"])
        assert own["blocks"] == [wheel[i % len(wheel)].hex() for i in range(own["codewords"])]
    shown = case["patterns"]
    for i, expected in shown.items() if isinstance(shown, dict) else enumerate(shown):
        rows = text_rows(patterns[int(i)])
        assert (rows if isinstance(expected, list) else "/".join(rows)) == expected
    assert digest(patterns) == case["sha256"]
