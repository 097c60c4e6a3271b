"""Points of a sweep: identity, seeds, and the computation of blocks."""

import hashlib
import json
import time
import traceback
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import heliograph
from heliograph import __version__
from heliograph.base import registry
from heliograph.base.config import from_mapping
from heliograph.base.errors import HeliographError, MediaError
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings, load_footage, load_imu
from heliograph.measure.bench import run_block
from heliograph.measure.counts import BlockCounts


@dataclass(frozen=True)
class Recorded:
    """Recording, identified by path and content."""

    # Absolute path
    path: str
    # First 32 hexadecimal digits of the SHA-256 of the content
    digest: str

    @classmethod
    def of(cls, path: Path) -> "Recorded":
        """Return the recording in a file."""
        try:
            with path.open("rb") as file:
                return cls(str(path.resolve()), hashlib.file_digest(file, "sha256").hexdigest()[:32])
        except OSError as error:
            raise MediaError(f"cannot read the recording {path}: {error.strerror or error}") from None


@dataclass(frozen=True)
class Point:
    """Point of a sweep."""

    # Varied values by key
    choice: Mapping[str, Any]
    settings: LinkSettings
    # Seed of the sweep, 0 to 2^63 - 1
    seed: int
    # Recordings by kind, "footage" and "imu"
    recordings: Mapping[str, Recorded] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """Key of the blocks in a store: a digest of all inputs."""
        recordings = {name: recorded.digest for name, recorded in sorted(self.recordings.items())}
        return _digest([asdict(self.settings), self.seed, build(), registry.digest(), recordings])

    def block_seed(self, block: int) -> int:
        """Return the seed of a block, equal for all receivers."""
        scene = {k: v for k, v in asdict(self.settings).items() if k != "receive"}
        sequence = np.random.SeedSequence([self.seed, int(_digest(scene), 16)], spawn_key=(block,))
        return int(sequence.generate_state(1, np.uint64)[0])

    def job(self, block: int) -> dict[str, Any]:
        """Return the input of `run_job` for a block as plain values."""
        recordings = {name: asdict(recorded) for name, recorded in self.recordings.items()}
        return {"settings": asdict(self.settings), "seed": self.block_seed(block), "recordings": recordings}

    @property
    def text(self) -> str:
        """Varied keys and values on a line."""
        return ", ".join(f"{key}={value}" for key, value in self.choice.items()) or "the point"


def build() -> str:
    """Return version and code digest of the package, on which results depend."""
    return f"{__version__}+{_code_digest()}"


@cache
def _code_digest() -> str:
    root, code = Path(heliograph.__file__).parent, hashlib.sha256()
    # results also depend on the parameters of trained receivers
    for path in sorted([*root.rglob("*.py"), *root.rglob("*.npz")]):
        code.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    return code.hexdigest()[:12]


def run_job(work: Mapping[str, Any]) -> dict[str, Any]:
    """Compute a block; return counts as plain values or the error of the link, computing time in s and version."""
    recordings = {name: load_recording(name, Recorded(**recorded)) for name, recorded in work["recordings"].items()}
    settings = from_mapping(LinkSettings, work["settings"])
    began, counts, refusal = time.perf_counter(), BlockCounts(), ""
    try:
        counts = run_block(settings, work["seed"], Recordings(**recordings))
    except HeliographError as error:
        refusal = str(error)
    except Exception as error:  # of a registered receiver
        last = traceback.extract_tb(error.__traceback__)[-1]
        error.add_note(f"{Path(last.filename).name}, line {last.lineno}")
        raise
    seconds = time.perf_counter() - began
    return {"counts": counts.to_plain(), "refusal": refusal, "seconds": seconds, "version": build()}


@lru_cache(maxsize=4)
def load_recording(kind: str, recorded: Recorded) -> Any:
    """Load a recording, "footage" or "imu", and verify the content."""
    path = Path(recorded.path)
    if Recorded.of(path).digest != recorded.digest:
        raise MediaError(f"the recording {path} has changed since planning; restore it, on all workers")
    return load_footage(path) if kind == "footage" else load_imu(path)


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()[:32]
