"""End-to-end live reception from Aravis' fake GigE Vision camera with a simulated array."""

import json
import re
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cli_runs import Run, failed, names, succeeded, within
from waiting import HANG_S

from heliograph.base.errors import HeliographError, MediaError
from heliograph.media import open_film
from heliograph.media.live.aravis import aravis
from heliograph.media.live.camera import CAMERAS
from heliograph.media.live.grabber import CameraTiming
from heliograph.media.live.reader import LiveReader

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "fake_camera.py"
NAME = "camera:aravis:Aravis-Fake-GV01"
ADDRESS = "camera:aravis:127.0.0.1"
"""The same camera, opened without the second that Aravis listens for the answers of all cameras."""
RATE, PAIRS, SIDE = 50, 12, 128
"""Frames and patterns per second, data pairs per packet, image side in px; a packet has 28 patterns."""
TEXT = "Red for 12 s."
SIGNAL = ("--receiver", "soft", "--set", f"signal.pattern_period_s={1 / RATE}", "--set", f"signal.data_pairs={PAIRS}")
CAMERA: dict[str, object] = {"rate_hz": RATE, "region": f"0,0,{SIDE},{SIDE}", "exposure_us": 20000, "queue_s": 60}


Served = subprocess.Popen[str]


def aravis_or_skip() -> None:
    try:
        aravis()
    except MediaError as error:
        pytest.skip(str(error))


@contextmanager
def served(*options: str) -> Iterator[Served]:
    """Run the camera in a separate process; wait for an answer."""
    aravis_or_skip()
    command = [sys.executable, str(EXAMPLE), *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            assert process.stdout is not None
            said = ""
            while "serving" not in said:
                line = process.stdout.readline()
                assert line, f"the camera could not be served: {said}"
                said += line
            yield process
        finally:
            process.send_signal(signal.SIGCONT)
            process.kill()


@pytest.fixture(scope="class")
def camera() -> Iterator[Served]:
    """Run a camera that loses UDP packets; only one camera can listen at a time."""
    options = ("--rate", RATE, "--data-pairs", PAIRS, "--side", SIDE, "--packets", 1, "--text", TEXT, "--lost", 6)
    with served(*map(str, options)) as process:
        yield process


def received(folder: Path, seconds: float, *options: str) -> Run:
    asked = [word for key, value in CAMERA.items() for word in ("--camera", f"{key}={value}")]
    return within(folder, "receive", NAME, *SIGNAL, *asked, "--duration", str(seconds), *options)


def opened(**asked: object) -> LiveReader:
    film = open_film(ADDRESS, camera=CAMERA | asked)
    assert isinstance(film, LiveReader)
    return film


@pytest.mark.usefixtures("camera")
class TestLive:
    def test_packets_are_received_despite_lost_frames(self, tmp_path: Path) -> None:
        says = succeeded(received(tmp_path, 6, "--output", "out"))
        assert f"array 0, high, message 0: {len(TEXT)} bytes, '{TEXT}'\n" in says
        assert (tmp_path / "out" / "array-0-high-0.bin").read_bytes() == TEXT.encode()
        packets = [json.loads(line) for line in (tmp_path / "out" / "packets.jsonl").read_text().splitlines()]
        report = json.loads((tmp_path / "out" / "summary.json").read_text())
        counts = report["camera"]
        assert (counts["model"], counts["host_clock"], counts["dropped"]) == ("Aravis Fake", False, 0)
        assert report["frames"] == counts["frames"] > 0
        # 15 UDP packets per frame: every eleventh frame is incomplete
        assert counts["incomplete"] + counts["lost"] >= 3
        assert report["arrays"][0]["layers"]["high"]["ok"] >= 1
        certain = [(packet["id"], packet["distance_m"]) for packet in packets if "uncertain" not in packet]
        assert certain == [(0, pytest.approx(20, rel=0.02))] * max(len(certain), 1)

    def test_frames_have_the_cameras_clock_and_numbers(self) -> None:
        with opened(duration_s=1) as film:
            frames, counts = list(film), film.counts
        assert counts is not None
        assert (counts.host_clock, counts.jumps) == (False, 0)
        assert all(frame.pixels.shape == (SIDE, SIDE) and frame.pixels.dtype == np.uint8 for frame in frames)
        # exposures start at multiples of the frame period
        for one, other in pairwise(frames):
            assert other.time_s - one.time_s == pytest.approx((other.index - one.index) / RATE, abs=1e-6)
        # one in six frames is incomplete: seven in a row after the last complete frame have a chance of 4e-6
        counted = counts.frames + counts.skipped + counts.lost + counts.incomplete
        assert frames[-1].index + 1 <= counted < frames[-1].index + 8

    def test_stop_ends_a_wait_and_releases_the_camera(self) -> None:
        for _ in range(2):
            with opened(rate_hz=1) as film:
                threading.Timer(0.1, film.stop).start()
                list(film)  # the camera itself is endless

    def test_changed_settings_are_reported(self, tmp_path: Path) -> None:
        with opened(exposure_us=100.7, gain=3, GainAuto="Off") as film:
            assert film.form.departures == ("exposure_us is 100, asked for 100.7",)
            expected = {"exposure_us": "100", "gain": "3", "rate_hz": "50", "pixel_format": "Mono8",
                        "region": f"0,0,{SIDE},{SIDE}", "trigger": "off", "GainAuto": "Off"}  # fmt: skip
            assert film.form.settings == expected
        asked = ("--camera", "exposure_us=100.7", "--camera", "trigger=Line0")
        run = received(tmp_path, 0.2, "--receiver", "plain", "--fps", "50", *asked)
        assert run.stderr.splitlines()[0] == f"heliograph: {NAME}: exposure_us is 100, asked for 100.7"
        assert (
            "gave no frame: check exposure and trigger, which must be off or have pulses" in run.stderr.splitlines()[1]
        )

    @pytest.mark.parametrize(("name", "bits"), [("Mono16", 16), ("BayerRG8", 8), ("RGB8", 8)])
    def test_other_pixels(self, name: str, bits: int) -> None:
        with opened(pixel_format=name, region="0,0,64,48") as film:
            first = next(iter(film))
            assert (film.width, film.height, film.bits) == (64, 48, bits)
        assert (first.pixels.shape, first.bits) == ((48, 64), bits)

    @pytest.mark.parametrize(("asked", "says"), [
        ({"pixel_format": "Mono12p"}, "it knows BayerBG8, BayerGB8"), ({"region": "0,0,100000,10"}, "setting 'region"),
        ({"region": "0,0,60000,10"}, "the camera does not take region=0,0,60000,10: "),
        ({"exposure_us": 1e9}, "the camera does not take exposure_us=1e+09: "),
        ({"trigger": "Line7"}, "the camera does not take trigger=Line7: "),
        ({"Nonsense": 3}, "the camera does not take Nonsense=3: "),
    ])  # fmt: skip
    def test_a_rejected_setting_is_one_line(self, asked: dict[str, object], says: str) -> None:
        with pytest.raises(HeliographError, match=re.escape(says)):
            opened(**asked)

    def test_a_missing_camera_is_one_line(self, tmp_path: Path) -> None:
        says = failed(within(tmp_path, "receive", "camera:aravis:nobody"))
        assert "no camera 'nobody' is found by Aravis" in says

    def test_frames_continue_after_a_lost_connection(self, camera: Served) -> None:
        said: list[str] = []

        def say(text: str) -> None:
            said.append(text)
            camera.send_signal(signal.SIGCONT)

        with opened(reconnect=100, duration_s=HANG_S) as film:
            film.say, film.timing = say, CameraTiming(silent_s=1.0, retry_s=(0.1,))
            places: list[tuple[int, float]] = []
            after = 0
            for frame in film:
                places.append((frame.index, frame.time_s))
                if len(places) == 20:  # as if unplugged
                    camera.send_signal(signal.SIGSTOP)
                after += bool(said) and "is back" in said[-1]
                if after == 20:
                    break
            counts = film.counts
        assert counts is not None
        assert counts.reconnections >= 1
        assert "is lost after" in said[0]
        assert all(one[0] < other[0] and one[1] < other[1] for one, other in pairwise(places))


BLOCK = re.compile(r"^```(sh|text)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[0-9.]*[0-9]")
MANY = re.compile(r"# (detection|packet|codeword)s\b")


def walk() -> list[tuple[str, str]]:
    """Return the command blocks from docs/cameras.md, each with the expected output."""
    page = (ROOT / "docs" / "cameras.md").read_text()
    blocks = BLOCK.findall(page.partition("## From a fresh clone\n")[2].partition("\n## ")[0])
    shown = [(text, output) for (kind, text), (other, output) in pairwise(blocks) if (kind, other) == ("sh", "text")]
    assert len(shown) == sum(kind == "text" for kind, _ in blocks), "each text shows what a command before it prints"
    return shown


def any_number(line: str) -> str:
    """Replace numbers by placeholders and plurals by singulars."""
    return MANY.sub(r"# \1", NUMBER.sub("#", line))


def test_the_page_on_cameras_shows_the_output_of_its_commands(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("genicam", reason="the walk needs 'pip install harvesters'")
    if any(Path("/dev").glob("video*")):
        pytest.skip("a webcam is here, which the walk does not show")
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    monkeypatch.setattr(CAMERAS, "_registered", {})  # another test of this process may have registered a camera
    with ExitStack() as stack:
        for commands, shown in walk():
            printed = "".join(typed(line, tmp_path, stack) for line in commands.splitlines())
            lines = [any_number(line) for line in printed.splitlines()]
            for line in shown.splitlines():
                alike = any_number(line.partition(";")[0])  # loss counts vary
                said = f"{commands}\ndoes not print\n{line}\nbut\n{printed}"
                assert any(one.startswith(alike) for one in lines), said


def typed(line: str, folder: Path, stack: ExitStack) -> str:
    """Run a command of the page; return its output."""
    match shlex.split(line):
        case ["heliograph", *arguments]:
            run = within(folder, *arguments)
            return run.stderr + run.stdout
        case ["python", "examples/fake_camera.py", ">", *_]:
            stack.enter_context(served("--packets", "1"))
            return f"serving {NAME}\n"
        case ["until", *_] | ["kill", *_]:  # the camera answers, and the stack ends the camera
            return ""
        case ["ls", results]:
            return "\n".join(names(folder / results))
    raise AssertionError(f"the test does not know {line}")
