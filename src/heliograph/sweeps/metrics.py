"""Metrics of a point: the definition of each value besides the error rates of the layers."""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

from heliograph.measure.counts import TICK_S, BlockCounts
from heliograph.measure.statistics import poisson_interval, quantile

Value = Callable[[BlockCounts], float]


class Metric(NamedTuple):
    """Metric of a point; NaN for no data, infinite times of arrays that were not acquired."""

    unit: str
    text: str
    value: Value


def _total(name: str, unit: str, text: str) -> dict[str, Metric]:
    """Return a count by name."""
    return {name: Metric(unit, text, lambda c: getattr(c, name))}


def _per_film(events: Callable[[BlockCounts], float], unit: str, text: str, seconds: float = 1.0) -> Metric:
    """Return events per time of the films."""
    return Metric(unit, text, lambda c: seconds * events(c) / c.film_s if c.film_s else math.nan)


def _times(name: str, text: str, among: Value | None = None) -> dict[str, Metric]:
    """Return median and 95 % quantile of the times in a histogram."""

    def value(c: BlockCounts, share: float) -> float:
        histogram = getattr(c, name)
        total = int(among(c)) if among else sum(histogram.values())
        return TICK_S * quantile(histogram, share, total) if total else math.nan

    return {
        f"{name}_median_s": Metric("s", f"{text}, median", lambda c: value(c, 0.5)),
        f"{name}_95_s": Metric("s", f"{text}, 95 % quantile", lambda c: value(c, 0.95)),
    }


def false_alarms(c: BlockCounts) -> int:
    """Return the number of received packets of no array."""
    return c.false_packets + c.uncertain_packets


def _mota(c: BlockCounts) -> float:
    """Return 1 - (missed packets + false positives) / packets (Bernardin and Stiefelhagen 2008)."""
    false = false_alarms(c) + c.duplicates + c.misplaced
    return 1 - (c.packets - c.located + false) / c.packets if c.packets else math.nan


METRICS = {
    "net_bits_per_second": _per_film(
        lambda c: sum(c.payload_bits.values()), "bit/s", "payload of decoded codewords per time"
    ),
    "goodput_bits_per_second": _per_film(
        lambda c: c.timely_bits, "bit/s", "payload of correct codewords, received within 0.1 s of the packet, per time"
    ),
    "film_seconds": Metric("s", "length of the films", lambda c: round(c.film_s, 9)),
    **_total("packets", "1", "complete packets in the films"),
    **_total("detected", "1", "complete packets with a detected header or decoded data"),
    **_total("false_codewords", "1", "accepted codewords that were not sent"),
    **_total("false_packets", "1", "received packets that were not sent"),
    **_total("uncertain_packets", "1", "received packets without a codeword, of an identity that was not sent"),
    **_total("duplicates", "1", "packets received again"),
    **_total("false_detections", "1", "detected headers that were not sent"),
    "false_alarms_per_minute": _per_film(false_alarms, "min-1", "false and uncertain packets per time", 60),
    "false_alarms_per_minute_low": _per_film(
        lambda c: poisson_interval(false_alarms(c))[0], "min-1", "low end of the 95 % interval of false alarms", 60
    ),
    "false_alarms_per_minute_high": _per_film(
        lambda c: poisson_interval(false_alarms(c))[1], "min-1", "high end of the 95 % interval of false alarms", 60
    ),
    "distance_error": Metric(
        "1",
        "relative rms error of the distance of received packets",
        lambda c: math.sqrt(c.distance_squares / c.distances) if c.distances else math.nan,
    ),
    "mota": Metric("1", "multiple object tracking accuracy of packets", _mota),
    "motp_px": Metric(
        "px",
        "multiple object tracking precision: mean error of the position of packets",
        lambda c: c.position_px / c.located if c.located else math.nan,
    ),
    **_total("posed", "1", "decoded packets with stated poses in space"),
    **_total("covered_positions", "1", "those with the true position in a stated 95 % region"),
    **_total("covered_poses", "1", "those with the true position and orientation in a stated 95 % region"),
    **_total("arrays", "1", "arrays with a complete packet, summed over the films"),
    "acquired": Metric("1", "arrays with a correct codeword", lambda c: sum(c.acquisition.values())),
    **_times("acquisition", "time from the first view of an array to the first correct codeword", lambda c: c.arrays),
    **_times("latency", "time from the start of a packet to the output, of packets with a correct codeword"),
}
"""Metrics by name, equal on all machines."""

PROCESSING = _times("processing", "processor time from a frame to the output of a packet with a codeword")
"""Metrics of the machine by name."""


def values(counts: BlockCounts, metrics: dict[str, Metric] = METRICS) -> dict[str, Any]:
    """Return the metrics by name; None for no data."""
    found = {name: metric.value(counts) for name, metric in metrics.items()}
    return {name: value if math.isfinite(value) else None for name, value in found.items()}
