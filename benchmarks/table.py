"""One table of speeds: ours, a peer or yardstick timed in turn with it, their ratio: `python -m benchmarks.table`.

    --json FILE    write the rows, and frames/s by stage, to a file too
    --keep         add them, with the commit and the machine's facts, to benchmarks/history.jsonl

One core. A row's two times are medians of runs that alternate, so that other work on the machine slows both.
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

os.environ.update(THREAD_LIMITS)  # before NumPy is imported: one core, and no threads that wait for each other

import cv2
import numpy as np
import pywt
from numpy.typing import NDArray

from benchmarks.turbo import ITERATIONS, noisy_blocks
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.media import create_film, open_film
from heliograph.receive import Pose, Receiver, make_receiver
from heliograph.receive.build import plain_receiver
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DetectEvent, ignore
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.kalman import MotionModel
from heliograph.receive.track.track import Track
from heliograph.receive.track.tracker import Tracker
from heliograph.signal import haar
from heliograph.signal.turbo import TurboCode

HISTORY = Path(__file__).with_name("history.jsonl")
"""One line of JSON a run: commit, time, machine, rows."""

RUNS = 7
FRAMES = 212
"""Two packets and a header."""

DISTANCE_M = 50.0

BLUR = "blur 5 x 5 of a frame"

Call = Callable[[], object]


@dataclass(frozen=True)
class Row:
    """A stage beside a peer.

    Attributes
    ----------
    stage
        What was timed.
    ours_ms
        Median time of one item in ms.
    peer
        What it is compared with, timed in the same run.
    peer_ms
        Median time of one item of the peer in ms.
    frames
        Frames that an item stands for; 0 where none.
    """

    stage: str
    ours_ms: float
    peer: str
    peer_ms: float
    frames: int = 1

    @property
    def ratio(self) -> float:
        """Ours over the peer's."""
        return self.ours_ms / self.peer_ms

    @property
    def frames_s(self) -> float:
        """Frames per second of ours; 0 where an item is no frame."""
        return 1e3 * self.frames / self.ours_ms


def in_turn(ours: Call, peer: Call, runs: int = RUNS) -> tuple[float, float]:
    """Median times in ms of two calls that alternate, after one of each to warm up.

    Parameters
    ----------
    ours, peer
        The calls.
    runs
        Times that each is called.
    """
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
    """Whole frames of an array at rest.

    Parameters
    ----------
    receiver
        Name of the receiver in the settings.
    background
        Kind of the background: "flat" or "synthetic".
    """
    channel = {"distance_m": DISTANCE_M, "duration_s": FRAMES * 1e-3, "background": {"kind": background}}
    settings = load_settings("static", {"channel": channel, "receive": {"receiver": receiver}})
    return settings, [frame for frame, _ in simulate(settings, default_messages(settings), 1)]


def searching(background: str) -> Iterator[Row]:
    """Looking for headers in whole frames: where an array is followed, and where each frame shows one to be found.

    Parameters
    ----------
    background
        Kind of the background: "flat" or "synthetic".
    """
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
    """Following an array from pair to pair, beside OpenCV's tracker MIL."""
    settings, frames = film("plain", "flat")
    detection = _first_detection(settings, frames)
    tracker = Tracker(settings.signal.side, MotionModel(settings.signal.pattern_period_s, 0.1))
    pairs = [FramePair(frames[k], frames[k + 1]) for k in range(4, 104, 2)]

    def follow() -> None:
        track: Track = tracker.start(detection)
        for pair in pairs:
            track = tracker.follow(track, pair).track

    # what the peer sees is what is tracked: the sum of pattern and inverse
    sums = [cv2.cvtColor(cv2.addWeighted(a.pixels, 0.5, b.pixels, 0.5, 0), cv2.COLOR_GRAY2BGR) for a, b in _two(frames)]
    pose = detection.fit.pose
    half = 0.5 * settings.signal.side * pose.pitch
    box = int(pose.x - half), int(pose.y - half), int(2 * half), int(2 * half)
    mil = cv2.TrackerMIL.create()
    mil.init(sums[0], box)
    ours, peer = in_turn(follow, partial(mil.update, sums[1]))
    return Row("follow a pair", ours / len(pairs), "OpenCV tracker MIL", peer, frames=2)


def whole(name: str, peer: str) -> Row:
    """A receiver over whole frames, beside a yardstick.

    Parameters
    ----------
    name
        Name of the receiver.
    peer
        "blur" for a Gaussian blur 5 x 5 of a frame, "inverse" for NumPy's inverse of 256 x 256 in single precision.
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
    """Decoding turbo codes, 8 iterations at 1 dB, beside scikit-commpy where it is installed, else the reference."""
    rng, code = np.random.default_rng(1), TurboCode(k=1024)
    _, llr = noisy_blocks(code, 64, 1.0, rng)
    title, peer = _commpy(code.k, rng) or ("NumPy reference", partial(_reference, llr[:4]))
    blocks = 1 if title != "NumPy reference" else 4
    for algorithm in ("max-log", "log-map"):
        ours, other = in_turn(partial(code.decode, llr, algorithm=algorithm, stop="none"), peer, 3)
        yield Row(f"turbo, a block of 1024, {algorithm}", ours / 64, title, other / blocks, frames=0)


def transform() -> Row:
    """The fast Haar transform of 48 patterns, beside PyWavelets'."""
    x = np.random.default_rng(0).normal(size=(48, 16, 16))
    ours, peer = in_turn(partial(_many, partial(haar.decode, x), 50), partial(_many, partial(pywt.dwt2, x, "haar"), 50))
    return Row("Haar transform of 48 patterns", ours / 50, "PyWavelets", peer / 50, frames=0)


def reading(suffix: str) -> Row:
    """Reading a film, beside OpenCV's reader of the same file.

    Parameters
    ----------
    suffix
        Of the film, ".mkv" for FFV1 or ".mp4" for H.264.
    """
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
    """All rows, one after another."""
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
    """Facts of the machine and of the commit."""
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
    """Print the table; keep it if asked to."""
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
    """The array as the receiver finds it."""
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
    """Its decoder of one block of the same constituent code, polynomials 13 and 15; None where it is not installed."""
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
