"""Counts of a point, and the stop rule."""

import math
import statistics
from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any

from pydantic import Field
from pydantic.dataclasses import dataclass

from heliograph import __version__
from heliograph.base.config import CONFIG, clear_errors
from heliograph.measure.bench import is_static
from heliograph.measure.counts import BlockCounts, LayerCounts
from heliograph.sweeps.points import Point


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class StopRule:
    """Rule for the completion of a point."""

    # Wrong codewords that complete a layer
    min_errors: Annotated[int, Field(ge=1)] = 50
    # Codewords that complete a layer; a point is complete with all layers
    max_codewords: Annotated[int, Field(ge=1)] = 1000
    # Limit of the total computing time of a point in s
    max_seconds: Annotated[float, Field(gt=0)] | None = None


class PointTally:
    """Sum of the blocks of a point in block order, independent of the order of arrival."""

    def __init__(self, point: Point, rule: StopRule, may_refuse: bool = False):
        self.point, self.rule = point, rule
        # True if the receiver may refuse the films, and the error if it does
        self.may_refuse, self.refusal = may_refuse, ""
        self.total = BlockCounts()
        self.blocks = 0
        self.seconds = 0.0
        self._frame_ms: list[float] = []
        self._waiting: dict[int, tuple[BlockCounts, float]] = {}

    def add(self, block: int, counts: BlockCounts, seconds: float) -> None:
        """Add a block, and count consecutive blocks until the point is complete."""
        if block >= self.blocks:
            self._waiting[block] = counts, seconds
        while not self.done and self.blocks in self._waiting:
            counts, seconds = self._waiting.pop(self.blocks)
            self.total += counts
            self.seconds += seconds
            self._frame_ms.append(1e3 * counts.receiver_s / max(counts.frames, 1))
            self.blocks += 1

    def refuse(self, refusal: str) -> None:
        """Complete the point without counts."""
        self.refusal, self.total = refusal, BlockCounts()

    def has(self, block: int) -> bool:
        """Return True if a block was added."""
        return block < self.blocks or block in self._waiting

    @property
    def done(self) -> bool:
        """True if the point is complete."""
        return self.ending is not None

    @property
    def ending(self) -> str | None:
        """Reason for completion: "errors", "codewords", "seconds", "empty" or "refused"; None if incomplete."""
        layers, rule = self.total.layers.values(), self.rule
        if self.refusal:
            return "refused"
        if all(layer.codeword_errors >= rule.min_errors for layer in layers):
            return "errors"
        if all(self._layer_fraction(layer) >= 1 for layer in layers) or self.blocks >= rule.max_codewords:
            return "codewords"
        # the films contain no complete packet
        if self.blocks >= 3 and not self.total.codewords:
            return "empty"
        return "seconds" if rule.max_seconds is not None and self.seconds >= rule.max_seconds else None

    @property
    def fraction(self) -> float:
        """Completed fraction of the point, 0 to 1."""
        if self.done:
            return 1.0
        counted = min(map(self._layer_fraction, self.total.layers.values()))
        return max(counted, self.seconds / self.rule.max_seconds if self.rule.max_seconds else 0.0)

    @property
    def net_bits_per_second(self) -> float | None:
        """Payload of decoded codewords per film time; None for zero films."""
        total = self.total
        return sum(total.payload_bits.values()) / total.film_s if total.film_s else None

    @property
    def frame_ms(self) -> float:
        """Processor time of the receiver in ms per frame: median of the blocks, as the first loads compiled code."""
        return statistics.median(self._frame_ms or [math.nan])

    @property
    def distance_error(self) -> float | None:
        """Relative rms error of the distances of received packets; None for no distance."""
        total = self.total
        return math.sqrt(total.distance_squares / total.distances) if total.distances else None

    def report(self) -> dict[str, Any]:
        """Return the point as plain values for JSON."""
        total = self.total
        out: dict[str, Any] = {
            "settings": dict(self.point.choice),
            "layers": {name: layer_report(layer) for name, layer in total.layers.items()},
            "net_bits_per_second": self.net_bits_per_second,
            "packets": total.packets,
            "detected": total.detected,
            "false_codewords": total.false_codewords,
            "false_packets": total.false_packets,
            "duplicates": total.duplicates,
            "distance_error": self.distance_error,
            "located": total.located,
            "covered_positions": total.covered_positions,
            "covered_poses": total.covered_poses,
            "film_seconds": round(total.film_s, 9),
            "blocks": self.blocks,
            "stopped_by": self.ending,
            "seed": self.point.seed,
            "version": __version__,
        }
        if not is_static(self.point.settings):
            bins = sorted(total.bins.items())
            out["distances"] = [
                {"from_m": start, "layers": {n: layer_report(c) for n, c in layers.items()}} for start, layers in bins
            ]
        return out

    def _layer_fraction(self, layer: LayerCounts) -> float:
        rule = self.rule
        return min(1.0, max(layer.codeword_errors / rule.min_errors, layer.codewords / rule.max_codewords))


def layer_report(counts: LayerCounts) -> dict[str, Any]:
    """Return counts, rates and 95 % intervals of a layer; rates are None for zero trials.

    Intervals are Clopper-Pearson intervals, for bits at the effective number of bits (see `Clustered`). "ber" is the
    bit error rate after the turbo decoder, "raw_ber" the rate by the first equalisation, and "final_raw_ber" the rate
    by the last equalisation, after cancellation of decoded codewords. "ber_is_bound" etc. mark zero errors with an
    upper bound. "packets_read" is the number of packets with counted bits.
    """
    out: dict[str, Any] = {"packets_read" if name == "packets" else name: n for name, n in asdict(counts).items()}
    rates = {"ber": counts.decoded, "raw_ber": counts.raw, "final_raw_ber": counts.final_raw, "fer": counts.words}
    for name, count in rates.items():
        out[name] = count.rate if count.trials else None
        out[f"{name}_ci"] = list(count.interval())
        out[f"{name}_is_bound"] = count.trials > 0 and not count.errors
    return out


def flat_report(layer: Mapping[str, Any]) -> dict[str, Any]:
    """Return the report of a layer with two values per interval, such as "ber_low" and "ber_high"."""
    flat = {name: value for name, value in layer.items() if not name.endswith("_ci")}
    for rate in [name for name in layer if f"{name}_ci" in layer]:
        flat[f"{rate}_low"], flat[f"{rate}_high"] = layer[f"{rate}_ci"]
    return flat
