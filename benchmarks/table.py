"""Speed table: each stage and a peer or yardstick, timed alternately: `python -m benchmarks.table`.

    --json FILE    write rows and frames/s by stage to a file
    --keep         append rows, commit and machine data to benchmarks/history.jsonl

The benchmark uses one core. Each row compares medians of alternating runs, so that background load affects both.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from heliograph.base.workers import THREAD_LIMITS, limit_threads

os.environ.update(THREAD_LIMITS)  # before importing NumPy: one core, no waiting threads

import cv2
import numpy as np
import pywt
from numpy.typing import NDArray

from benchmarks.turbo import ITERATIONS, noisy_blocks
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.media import create_film, open_film
from heliograph.receive.api import make_receiver
from heliograph.receive.build import plain_receiver
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DetectEvent, ignore
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.packet import Receiver
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.kalman import MotionModel
from heliograph.receive.track.track import Track
from heliograph.receive.track.tracker import Tracker
from heliograph.signal import haar
from heliograph.signal.turbo import TurboCode

HISTORY = Path(__file__).with_name("history.jsonl")
"""JSON lines, one run per line: commit, time, machine, rows."""

RUNS = 7
FRAMES = 212
"""Two packets and a header."""

DISTANCE_M = 50.0

BLUR = "blur 5 x 5 of a frame"

Call = Callable[[], object]


@dataclass(frozen=True)
class Row:
    """Times of a stage and a peer.

    Attributes
    ----------
    stage
        Measured stage.
    ours_ms
        Median time per item in ms.
    peer
        Peer measured in the same run.
    peer_ms
        Median time per item for the peer in ms.
    frames
        Frames per item, or 0.
    """

    stage: str
    ours_ms: float
    peer: str
    peer_ms: float
    frames: int = 1

    @property
    def ratio(self) -> float:
        """Time relative to the peer."""
        return self.ours_ms / self.peer_ms

    @property
    def frames_s(self) -> float:
        """Frames per second, or 0 for items other than frames."""
        return 1e3 * self.frames / self.ours_ms


def in_turn(ours: Call, peer: Call, runs: int = RUNS) -> tuple[float, float]:
    """Return median times in ms for two alternating calls, after a warm-up call each."""
    times: list[list[float]] = [[], []]
    for run in range(runs + 1):
        for call, taken in zip((ours, peer), times, strict=True):
            start = time.process_time()
            call()
            if run:
                taken.append(time.process_time() - start)
    first, second = (1e3 * statistics.median(taken) for taken in times)
    return first, second


def film(receiver: str, background: str) -> tuple[LinkSettings, list[Frame]]:
    """Simulate full frames with an array at rest on a "flat" or "synthetic" background."""
    channel = {"distance_m": DISTANCE_M, "duration_s": FRAMES * 1e-3, "background": {"kind": background}}
    settings = load_settings("static", {"channel": channel, "receive": {"receiver": receiver}})
    return settings, [frame for frame, _ in simulate(settings, default_messages(settings), 1)]


def searching(background: str) -> Iterator[Row]:
    """Time the header search in full frames, with a tracked array and with a header in each frame."""
    settings, frames = film("plain", background)
    pose = _first_detection(settings, frames).fit.pose

    def search(taken: Sequence[Pose]) -> None:
        search = plain_receiver(settings.signal, settings.receive, ignore).search
        search.start(settings.signal.pattern_period_s)
        for frame in frames:
            search.search(frame, taken)

    pixels, out = frames[0].pixels, np.empty_like(frames[0].pixels)
    ours, peer = in_turn(partial(search, [pose]), partial(_many, lambda: cv2.GaussianBlur(pixels, (5, 5), 0, out), 50))
    yield Row(f"search, {background}", ours / len(frames), BLUR, peer / 50)
    aruco = cv2.aruco.ArucoDetector(cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    ours, peer = in_turn(partial(search, []), partial(_many, partial(aruco.detectMarkers, pixels), 5))
    yield Row(f"find in each frame, {background}", ours / len(frames), "OpenCV ArUco", peer / 5)


def following() -> Row:
    """Time tracking from pair to pair against OpenCV's MIL tracker."""
    settings, frames = film("plain", "flat")
    detection = _first_detection(settings, frames)
    tracker = Tracker(settings.signal.side, MotionModel(settings.signal.pattern_period_s, 0.1))
    pairs = [FramePair(frames[k], frames[k + 1]) for k in range(4, 104, 2)]

    def follow() -> None:
        track: Track = tracker.start(detection)
        for pair in pairs:
            track = tracker.follow(track, pair).track

    # the peer gets the sum of pattern and inverse, as the tracker does
    sums = [cv2.cvtColor(cv2.addWeighted(a.pixels, 0.5, b.pixels, 0.5, 0), cv2.COLOR_GRAY2BGR) for a, b in _two(frames)]
    pose = detection.fit.pose
    half = 0.5 * settings.signal.side * pose.pitch
    box = int(pose.x - half), int(pose.y - half), int(2 * half), int(2 * half)
    mil = cv2.TrackerMIL.create()
    mil.init(sums[0], box)
    ours, peer = in_turn(follow, partial(mil.update, sums[1]))
    return Row("follow a pair", ours / len(pairs), "OpenCV tracker MIL", peer, frames=2)


def whole(name: str, peer: str) -> Row:
    """Time a receiver on full frames against a yardstick.

    The yardstick is "blur", a 5 x 5 Gaussian blur, or "inverse", NumPy's inverse of a 256 x 256 float32 matrix.
    """
    settings, frames = film(name, "flat")

    def receive() -> None:
        receiver: Receiver = make_receiver(settings.signal, settings.receive)
        for frame in frames:
            list(receiver.push(frame))

    a, out = frames[0].pixels, np.empty_like(frames[0].pixels)
    matrix = np.random.default_rng(0).normal(size=(256, 256)).astype(np.float32)
    calls: dict[str, tuple[str, Call]] = {
        "blur": (BLUR, lambda: cv2.GaussianBlur(a, (5, 5), 0, out)),
        "inverse": ("inverse of 256 x 256", lambda: np.linalg.inv(matrix)),
    }
    title, call = calls[peer]
    ours, other = in_turn(receive, partial(_many, call, 20))
    return Row(f'receiver "{name}"', ours / len(frames), title, other / 20)


def turbo() -> Iterator[Row]:
    """Time turbo decoding, 8 iterations at 1 dB, against scikit-commpy if installed, otherwise the reference."""
    rng, code = np.random.default_rng(1), TurboCode(k=1024)
    _, llr = noisy_blocks(code, 64, 1.0, rng)
    title, peer = _commpy(code.k, rng) or ("NumPy reference", partial(_reference, llr[:4]))
    blocks = 1 if title != "NumPy reference" else 4
    for algorithm in ("max-log", "log-map"):
        ours, other = in_turn(partial(code.decode, llr, algorithm=algorithm, stop="none"), peer, 3)
        yield Row(f"turbo, a block of 1024, {algorithm}", ours / 64, title, other / blocks, frames=0)


def transform() -> Row:
    """Time the fast Haar transform of 48 patterns against PyWavelets."""
    x = np.random.default_rng(0).normal(size=(48, 16, 16))
    ours, peer = in_turn(partial(_many, partial(haar.decode, x), 50), partial(_many, partial(pywt.dwt2, x, "haar"), 50))
    return Row("Haar transform of 48 patterns", ours / 50, "PyWavelets", peer / 50, frames=0)


def reading(suffix: str) -> Row:
    """Time reading a film, ".mkv" (FFV1) or ".mp4" (H.264), against OpenCV's reader."""
    _, frames = film("plain", "synthetic")
    height, width = frames[0].pixels.shape
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"film{suffix}"
        with create_film(path, width=width, height=height, rate_hz=1000.0, bits=8) as sink:
            for frame in frames:
                sink.write(frame)
        ours, peer = in_turn(partial(_read, path), partial(_read_by_opencv, path), 3)
    return Row(f"read a film, {suffix}", ours / len(frames), "OpenCV VideoCapture", peer / len(frames))


def rows() -> Iterator[Row]:
    """Yield all rows."""
    yield from searching("flat")
    yield from searching("synthetic")
    yield following()
    yield whole("plain", "blur")
    yield whole("soft", "inverse")
    yield transform()
    yield from turbo()
    yield reading(".mkv")
    yield reading(".mp4")


def facts() -> dict[str, Any]:
    """Return machine and commit data."""
    model = next((line.split(":")[1].strip() for line in _lines("/proc/cpuinfo") if "model name" in line), "")
    commit = subprocess.run(
        ["git", "describe", "--always", "--dirty"], capture_output=True, text=True, check=False
    ).stdout.strip()
    versions = {name: __import__(name).__version__ for name in ("numpy", "scipy", "numba", "cv2", "av")}
    return {
        "commit": commit,
        "time": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "processor": model or platform.processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        **versions,
    }


def main() -> None:
    """Print the table; append to the history with --keep."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--keep", action="store_true")
    given = parser.parse_args()
    limit_threads()
    cv2.setNumThreads(1)
    found: list[Row] = []
    print(f"{'stage':34} {'ms':>9} {'frames/s':>9}   {'beside':24} {'ms':>9} {'ratio':>8}", flush=True)
    for row in rows():
        found.append(row)
        per_s = f"{row.frames_s:9.0f}" if row.frames else f"{'-':>9}"
        print(
            f"{row.stage:34} {row.ours_ms:9.4f} {per_s}   {row.peer:24} {row.peer_ms:9.4f} {row.ratio:8.3g}", flush=True
        )
    result = {
        **facts(),
        "rows": [{**asdict(row), "ratio": row.ratio} for row in found],
        "frames_s": {row.stage: row.frames_s for row in found if row.frames},
    }
    if given.json is not None:
        given.json.write_text(json.dumps(result, indent=1) + "\n")
    if given.keep:
        with HISTORY.open("a") as file:
            file.write(json.dumps(result) + "\n")


def _lines(path: str) -> list[str]:
    return Path(path).read_text().splitlines() if Path(path).exists() else []


def _two(frames: Sequence[Frame]) -> Iterator[tuple[Frame, Frame]]:
    for k in range(4, 8, 2):
        yield frames[k], frames[k + 1]


def _many(call: Call, times: int) -> None:
    for _ in range(times):
        call()


def _first_detection(settings: LinkSettings, frames: Sequence[Frame]) -> Detection:
    """Return the receiver's first detection."""
    found: list[Detection] = []

    def observe(event: object) -> None:
        if isinstance(event, DetectEvent):
            found.append(event.detection)

    receiver = make_receiver(settings.signal, settings.receive, observe)
    for frame in frames:
        list(receiver.push(frame))
        if found:
            return found[0]
    raise RuntimeError("the array of the film was not found")


def _commpy(k: int, rng: np.random.Generator) -> tuple[str, Call] | None:
    """Return scikit-commpy's decoder for an equivalent block, polynomials 13 and 15, or None if not installed."""
    try:
        from commpy.channelcoding import RandInterlv, Trellis
        from commpy.channelcoding.turbo import turbo_decode, turbo_encode
    except ImportError:
        return None
    trellis = Trellis(np.array([3]), np.array([[0o13, 0o15]]), feedback=0o13, code_type="rsc")
    mixed, variance = RandInterlv(k, 1), 0.5 * 3 / 10**0.1
    parts = turbo_encode(rng.integers(0, 2, k), trellis, trellis, mixed)
    noisy = [2.0 * part[:k] - 1 + rng.normal(0, variance**0.5, k) for part in parts]
    return "scikit-commpy", partial(turbo_decode, *noisy, trellis, variance, ITERATIONS, mixed)


def _reference(llr: NDArray[np.float32]) -> None:
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "oracles"))
    import turbo_oracle as oracle

    from heliograph.signal.turbo import DecoderOptions
    from heliograph.signal.turbo.qpp import interleaver

    oracle.decode(llr.astype(np.float64), interleaver(1024), DecoderOptions(iterations=ITERATIONS))


def _read(path: Path) -> None:
    with open_film(path) as film:
        for _ in film:
            pass


def _read_by_opencv(path: Path) -> None:
    capture = cv2.VideoCapture(str(path))
    while capture.read()[0]:
        pass


if __name__ == "__main__":
    main()
