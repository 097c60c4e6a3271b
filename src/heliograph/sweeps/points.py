"""Points of a sweep: their identity, the stop rule, and what was counted."""

import hashlib
import json
import math
import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from heliograph import __version__
from heliograph.base.config import from_mapping, to_mapping
from heliograph.base.errors import MediaError, SettingsError
from heliograph.link.recordings import load_footage, load_imu
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings
from heliograph.measure.bench import run_block, stands_still
from heliograph.measure.counts import BlockCounts, LayerCounts

EMPTY_BLOCKS = 3
"""Blocks without any codeword after which a point is given up: its films hold no whole packet."""


@dataclass(frozen=True, kw_only=True)
class StopRule:
    """When a point has been counted for long enough.

    Attributes
    ----------
    min_errors
        A layer has enough with so many wrong codewords,
    max_codewords
        or with so many codewords; blocks are counted whole. A point has enough when all its layers have.
    max_seconds
        Computing time of a point, of all workers together, after which no block is begun; None: no limit.
    """

    min_errors: int = 50
    max_codewords: int = 1000
    max_seconds: float | None = None

    def __post_init__(self) -> None:
        """Check the values."""
        for name in ("min_errors", "max_codewords"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name} is at least 1, not {getattr(self, name)}")
        if self.max_seconds is not None and not 0 < self.max_seconds < math.inf:
            raise SettingsError(f"max_seconds is above 0, not {self.max_seconds}")


@dataclass(frozen=True)
class Recorded:
    """A recording by its path and by a digest of its content, which tells it from others of its name."""

    path: str
    digest: str

    @classmethod
    def of(cls, path: Path) -> "Recorded":
        """The recording in a file, as it is now; a MediaError where it cannot be read."""
        try:
            with path.open("rb") as file:
                return cls(str(path.resolve()), hashlib.file_digest(file, "sha256").hexdigest()[:32])
        except OSError as error:
            raise MediaError(f"cannot read the recording {path}: {error.strerror or error}") from None


@dataclass(frozen=True)
class Point:
    """One point of a sweep.

    Attributes
    ----------
    choice
        What varies, by key as it was given.
    settings
        The whole link.
    seed
        Of the sweep.
    recordings
        "footage" and "imu", where there are any.
    """

    choice: Mapping[str, Any]
    settings: LinkSettings
    seed: int
    recordings: Mapping[str, Recorded] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """What a store knows the point's blocks by: all that they depend on."""
        about = [to_mapping(self.settings), self.seed, build()]
        return _digest([*about, {name: one.digest for name, one in sorted(self.recordings.items())}])

    def block_seed(self, block: int) -> int:
        """Seed of a block. It does not depend on the receiver: all receivers get the same films."""
        scene = {k: v for k, v in to_mapping(self.settings).items() if k != "receive"}
        sequence = np.random.SeedSequence([self.seed, int(_digest(scene), 16)], spawn_key=(block,))
        return int(sequence.generate_state(1, np.uint64)[0])

    def job(self, block: int) -> dict[str, Any]:
        """A block's work as plain values, for a worker anywhere."""
        recordings = {name: asdict(one) for name, one in self.recordings.items()}
        return {"settings": to_mapping(self.settings), "seed": self.block_seed(block), "recordings": recordings}

    @property
    def text(self) -> str:
        """What tells the point from others, as a line."""
        return ", ".join(f"{key}={value}" for key, value in self.choice.items()) or "the point"


def build() -> str:
    """Version and a digest of the package's code: results depend on it as they do on settings and seed."""
    return f"{__version__}+{_code_digest()}"


@cache
def _code_digest() -> str:
    root, code = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        code.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return code.hexdigest()[:12]


class PointTally:
    """Blocks of a point, counted in their order whatever the order in which they come.

    Parameters
    ----------
    point, rule
        What is counted, and for how long.
    """

    def __init__(self, point: Point, rule: StopRule):
        self.point, self.rule = point, rule
        self.total = BlockCounts()
        self.blocks = 0
        """Blocks counted."""
        self.seconds = 0.0
        self._waiting: dict[int, tuple[BlockCounts, float]] = {}

    def add(self, block: int, counts: BlockCounts, seconds: float) -> None:
        """Take a block; it is counted once all before it are, unless the point has enough by then."""
        if block >= self.blocks:
            self._waiting[block] = counts, seconds
        while not self.done and self.blocks in self._waiting:
            counts, seconds = self._waiting.pop(self.blocks)
            self.total += counts
            self.seconds += seconds
            self.blocks += 1

    def has(self, block: int) -> bool:
        """Whether a block was taken."""
        return block < self.blocks or block in self._waiting

    @property
    def done(self) -> bool:
        """Whether the point has enough."""
        return self.ending is not None

    @property
    def ending(self) -> str | None:
        """Why the point has enough: "errors", "codewords", "seconds" or "empty"; None if it has not."""
        layers, rule = self.total.layers.values(), self.rule
        if all(layer.codeword_errors >= rule.min_errors for layer in layers):
            return "errors"
        if all(self._share(layer) >= 1 for layer in layers) or self.blocks >= rule.max_codewords:
            return "codewords"
        if self.blocks >= EMPTY_BLOCKS and not self.total.codewords:
            return "empty"
        return "seconds" if rule.max_seconds is not None and self.seconds >= rule.max_seconds else None

    @property
    def share(self) -> float:
        """How much of the point is done, 0 to 1."""
        if self.done:
            return 1.0
        counted = min(map(self._share, self.total.layers.values()))
        return max(counted, self.seconds / self.rule.max_seconds if self.rule.max_seconds else 0.0)

    @property
    def net_bits_per_second(self) -> float | None:
        """Payload of the codewords read by time of film; None without films."""
        total = self.total
        return sum(total.payload_bits.values()) / total.film_s if total.film_s else None

    def report(self) -> dict[str, Any]:
        """The point as plain values, for JSON."""
        total = self.total
        out: dict[str, Any] = {
            "settings": dict(self.point.choice),
            "layers": {name: layer_report(layer) for name, layer in total.layers.items()},
            "net_bits_per_second": self.net_bits_per_second,
            "false_codewords": total.false_codewords,
            "false_packets": total.false_packets,
            "duplicates": total.duplicates,
            "film_seconds": round(total.film_s, 9),
            "blocks": self.blocks,
            "stopped_by": self.ending,
            "seed": self.point.seed,
            "version": __version__,
        }
        if not stands_still(self.point.settings):
            bins = sorted(total.bins.items())
            out["distances"] = [
                {"from_m": start, "layers": {n: layer_report(c) for n, c in layers.items()}} for start, layers in bins
            ]
        return out

    def _share(self, layer: LayerCounts) -> float:
        rule = self.rule
        return min(1.0, max(layer.codeword_errors / rule.min_errors, layer.codewords / rule.max_codewords))


def run_job(work: Mapping[str, Any]) -> dict[str, Any]:
    """Do the work of `Point.job`: a block's counts as plain values, its computing time, and by which version.

    Raises
    ------
    HeliographError
        A recording is not here what it is where the sweep was planned, or the block cannot be computed.
    """
    recordings = {name: _load(name, Recorded(**one)) for name, one in work["recordings"].items()}
    settings = from_mapping(LinkSettings, work["settings"])
    began = time.perf_counter()
    counts = run_block(settings, work["seed"], Recordings(**recordings))
    return {"counts": counts.to_plain(), "seconds": time.perf_counter() - began, "version": build()}


def layer_report(counts: LayerCounts) -> dict[str, Any]:
    """Counts of a layer with their rates and 95 % intervals; None where nothing was counted.

    Intervals are Clopper-Pearson's, of the bit error rate at the effective number of bits, since bits of a packet fail
    together (see `Clustered`). "ber_is_bound" and "fer_is_bound" tell where no error was met: the rate 0 then means no
    more than that it is below the interval's upper end.
    """
    out: dict[str, Any] = asdict(counts)
    for name, count in (("ber", counts.decoded), ("fer", counts.words)):
        out[name] = count.rate if count.trials else None
        out[f"{name}_ci"] = list(count.interval())
        out[f"{name}_is_bound"] = count.trials > 0 and not count.errors
    return out


@lru_cache(maxsize=4)
def _load(kind: str, recorded: Recorded) -> Any:
    """A recording, if its content is that the results are kept under; machines of a cluster may have others."""
    path = Path(recorded.path)
    if Recorded.of(path).digest != recorded.digest:
        raise MediaError(
            f"the recording {path} is not the one the sweep was planned with; give all workers the same file"
        )
    return load_footage(path) if kind == "footage" else load_imu(path)


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:32]
