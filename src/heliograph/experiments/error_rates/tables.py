"""Error rates and their comparison as tables and plain values."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from heliograph.experiments.error_rates.comparison import MARGIN, Comparison
from heliograph.experiments.error_rates.films import CountsByDistance, all_layers
from heliograph.experiments.result import Table
from heliograph.measure.counts import Layers
from heliograph.measure.errors import BIN_M
from heliograph.signal.settings import LAYERS


def rates_table(static: CountsByDistance, driving: CountsByDistance, keyed: CountsByDistance) -> Table:
    """Error rates at rest, driving and of on-off keying, a row per distance."""
    head = ["distance"]
    head += [f"{n}: {what}" for n in LAYERS for what in ("raw", "decoded", "codewords wrong")] + ["on-off keying: raw"]
    rows = [_rates_row(f"static {z:g} m", layers, keyed.places.get(z)) for z, layers in sorted(static.places.items())]
    rows += [
        _rates_row(f"driving {z - BIN_M / 2:g}-{z + BIN_M / 2:g} m", layers, None)
        for z, layers in sorted(driving.places.items())
    ]
    return Table(
        "Bit error rates; no error among n raw bits, or after the code n packets, is written < 3/n", head, rows
    )


def _rates_row(name: str, layers: Layers, keyed: Layers | None) -> list[str]:
    cells = [name]
    for one in layers.values():
        cells += [one.raw.text(), one.decoded.text(), f"{one.codeword_errors} of {one.codewords}"]
    return [*cells, all_layers(keyed).text() if keyed else ""]


def comparison_table(found: Sequence[Comparison]) -> Table:
    """Driving against static, a row a comparison."""
    head = ("layer", "distance", "packets", "driving", "static", "ratio", "95 % interval", "p (Holm)", "verdict")
    rows = [
        (
            c.layer,
            "all" if c.bin_m is None else f"{c.bin_m - BIN_M / 2:g}-{c.bin_m + BIN_M / 2:g} m",
            str(c.pairs),
            f"{c.driving:.1e}",
            f"{c.static:.1e}",
            f"{c.ratio:.2f}",
            f"{c.low:.2f}-{c.high:.2f}",
            f"{c.p:.3f}",
            c.verdict,
        )
        for c in found
    ]
    return Table(f"Driving against static, raw; alike: within a factor {MARGIN:g}", head, rows)


def plain_values(
    static: CountsByDistance, driving: CountsByDistance, keyed: CountsByDistance, found: Sequence[Comparison]
) -> dict[str, Any]:
    """All counts and comparisons as plain values, for JSON."""

    def plain(sums: CountsByDistance) -> list[dict[str, Any]]:
        return [{"distance_m": z, **{n: asdict(c) for n, c in by.items()}} for z, by in sorted(sums.places.items())]

    return {
        "static": plain(static),
        "driving": plain(driving),
        "ook": plain(keyed),
        "comparison": [asdict(c) for c in found],
    }
