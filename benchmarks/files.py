"""File transfer: symbols and processor time needed per file.

    python -m benchmarks.files [--trials 60]

The table covers several file sizes with 108-byte symbols and 20 % random loss. Columns: symbols sent until completion,
relative to the file size in symbols, for the fountain code and for a segment carousel; failures after exactly as many
received symbols as the file has; encoder time per symbol; decoder time with 20 % and 100 % of source symbols lost.
"""

import argparse
import random
import time
from collections.abc import Callable
from importlib.util import find_spec

from heliograph.base.errors import HeliographError
from heliograph.measure.statistics import Count
from heliograph.signal.fountain.codes import CODES, CodeName, Encoder

LOSS = 0.2


def timed(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began


def received(rng: random.Random, encoder: Encoder, count: int, start: int, loss: float) -> dict[int, bytes]:
    """Receive `count` symbols from `start` on, with random losses."""
    out: dict[int, bytes] = {}
    number = start
    while len(out) < count:
        if rng.random() >= loss:
            out[number] = encoder.symbol(number)
        number += 1
    return out


def sent_by_carousel(rng: random.Random, count: int) -> int:
    """Return the number of segments sent until all have arrived."""
    missing, sent = set(range(count)), 0
    while missing:
        if rng.random() >= LOSS:
            missing.discard(sent % count)
        sent += 1
    return sent


def row(name: CodeName, size: int, trials: int, rng: random.Random) -> str:
    code, width = CODES[name], 108 if name == "cauchy" else 104
    data = rng.randbytes(size)
    encoder = code.encoder(data, width)
    exact, failed = Count(), 0
    for _ in range(trials):
        got = received(rng, encoder, encoder.count, rng.randrange(encoder.count), LOSS)
        found = code.decode(got, size, width)
        failed += found is None or found[:size] != data
    exact.add(trials, failed)
    symbol_s = timed(lambda: code.encoder(data, width).symbol(encoder.count))
    some = received(rng, encoder, encoder.count, 0, LOSS)
    late = received(rng, encoder, encoder.count + 2, encoder.count, 0.0)
    some_s = timed(lambda: code.decode(some, size, width))
    late_s = timed(lambda: code.decode(late, size, width))
    turns = sum(sent_by_carousel(rng, encoder.count) for _ in range(20)) / 20 / encoder.count
    low, high = exact.interval()
    return (
        f"{name:8} {size:8d} bytes {encoder.count:5d} symbols; "
        f"failed at k: {failed}/{trials} ({low:.3f} to {high:.3f}); first symbol {symbol_s * 1e3:7.1f} ms, "
        f"a fifth lost {some_s * 1e3:8.1f} ms, all repair {late_s * 1e3:8.1f} ms; "
        f"carousel {turns:.2f} turns, code {1 / (1 - LOSS):.2f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=60)
    trials = parser.parse_args().trials
    rng = random.Random(11)
    names: list[CodeName] = ["cauchy", "raptorq"] if find_spec("raptorq") else ["cauchy"]
    for size, share in ((2_000, 1.0), (20_000, 1.0), (100_000, 0.2), (1_000_000, 0.0)):
        for name in names:
            try:
                print(row(name, size, max(1, round(share * trials)), rng), flush=True)
            except HeliographError as error:
                print(f"{name}: {error}")


if __name__ == "__main__":
    main()
