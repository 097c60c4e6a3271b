"""`heliograph receive camera:NAME` and `heliograph cameras`, with a film as camera."""

import json
import signal
from pathlib import Path

import numpy as np
import pytest
from cli_runs import Call, Run, failed, interrupted_at, lasting, names, succeeded, within
from film_checks import uniform, write_levels

from heliograph.media import open_film

pytestmark = pytest.mark.slow

PLAYED = Path(__file__).parents[1] / "helpers" / "played_camera.py"
HIGH = b"brake: red for 12 s"


@pytest.fixture
def call(call: Call) -> Call:
    return lambda *arguments: call("--load", PLAYED, *arguments)


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create a film with slightly more than three packets from a small camera."""
    folder = tmp_path_factory.mktemp("film")
    (folder / "high").write_bytes(HIGH)
    succeeded(within(folder, "simulate", "a.h5", *lasting(0.32), "--seed", "4", "--high", "high"))
    return folder / "a.h5"


@pytest.fixture(scope="module")
def vanishing(film: Path) -> Path:
    """Switch the array off within the second packet."""
    path, random = film.parent / "vanishing.h5", np.random.default_rng(0)
    with open_film(film) as source:
        levels = np.stack([frame.pixels for frame in source])
        levels[120:] = random.integers(20, 26, levels[120:].shape)
        return write_levels(path, levels, source.rate_hz)


def received(call: Call, film: Path, *options: str | Path) -> Run:
    return call("receive", f"camera:played:{film}", "--preset", "static", *options)


def test_a_camera_is_received_like_its_film(call: Call, film: Path, tmp_path: Path) -> None:
    says = succeeded(received(call, film, "--output", "out", "--record", "kept.h5", "--record-s", "0.1"))
    assert not (tmp_path / "kept.h5").exists()  # no failure
    choice, first, *_ = says.splitlines()
    assert choice == "receiver soft: 1000 frames/s, 1000 patterns/s"
    assert first == f"array 0, high, message 0: {len(HIGH)} bytes, '{HIGH.decode()}'"
    assert "array 0: 3 packets" in says
    assert "camera: 320 frames, 1000.0 per second by the camera's clock\n" in says
    assert (tmp_path / "out" / "array-0-high-0.bin").read_bytes() == HIGH
    succeeded(call("receive", film, "--preset", "static", "--output", "film"))
    assert (tmp_path / "out" / "packets.jsonl").read_text() == (tmp_path / "film" / "packets.jsonl").read_text()


def test_json_has_the_counts_of_the_camera(call: Call, film: Path) -> None:
    report = json.loads(succeeded(received(call, film, "--json", "--camera", "Lost=40", "--camera", "Broken=150")))
    expected = {"frames": 318, "lost": 1, "incomplete": 1, "dropped": 0, "settings": {"gain": "1"}}
    assert (report["camera"] | expected, report["arrays"][0]["packets"], report["frames"]) == (report["camera"], 3, 318)


@pytest.mark.parametrize("reconnect", [True, False])
def test_results_before_a_lost_connection_are_kept(call: Call, film: Path, tmp_path: Path, reconnect: bool) -> None:
    asked = () if reconnect else ("--camera", "reconnect=0")
    run = received(call, film, "--camera", "Unplugged=110", *asked, "--output", "out")
    assert f"array 0: {'4 packets' if reconnect else '1 packet,'}" in run.stdout
    assert ("; reconnected: 1\n" in run.stdout) == reconnect
    if reconnect:
        first, second = run.stderr.splitlines()
        assert "is lost after 110 frames (the cable was pulled); try 1 of 6 in 1 s" in first
        assert "is back after" in second
        assert run.returncode == 0
    else:
        assert "is lost after 110 frames (the cable was pulled): check cable and power" in failed(run)
    assert names(tmp_path / "out")[-2:] == ["packets.jsonl", "summary.json"]


ENDLESS = ("--camera", "Times=0", "--camera", "Speed=300")


def test_the_first_ctrl_c_ends_a_reception_like_the_end_of_a_film(film: Path, tmp_path: Path) -> None:
    command = ("--load", PLAYED, "receive", f"camera:played:{film}", "--preset", "static", *ENDLESS, "--output", "out",
               "--json", "--set", "receive.decode.in_background=false")  # fmt: skip
    report = json.loads(succeeded(interrupted_at(tmp_path, *command, title="receiving", step=150)))
    assert report["arrays"][0]["packets"] >= 1
    assert report["camera"]["frames"] >= report["frames"] >= 150
    assert names(tmp_path / "out") == ["array-0-high-0.bin", "packets.jsonl", "summary.json"]


@pytest.fixture
def dark(tmp_path: Path) -> Path:
    """Create a film without an array, in a separate folder."""
    (tmp_path / "films").mkdir()
    return write_levels(tmp_path / "films" / "dark.h5", uniform(20 + np.arange(120) % 2, 48, 64))


def test_a_missing_array_is_explained_by_probe(call: Call, dark: Path) -> None:
    run = received(call, dark)
    assert run.returncode == 3
    assert f"'heliograph probe camera:played:{dark}' describes the frames" in run.stdout


def test_the_last_seconds_without_an_array_are_kept(call: Call, dark: Path) -> None:
    run = received(call, dark, "--record", "kept.h5", "--record-s", "0.1005")
    assert run.returncode == 3
    with open_film("kept.h5") as kept:
        assert [frame.index for frame in kept] == list(range(19, 120))
    assert run.stdout.endswith("the last 101 frames are kept in kept.h5\n")
    assert "'heliograph probe kept.h5' describes the frames" in run.stdout
    assert call("probe", "kept.h5").returncode == 3


def test_a_failure_is_recorded_and_can_be_received(call: Call, vanishing: Path, tmp_path: Path) -> None:
    says = succeeded(received(call, vanishing, "--record", "kept.h5", "--record-s", "1"))
    assert says.splitlines()[-1].endswith("frames of kept.h5")
    assert names(tmp_path) == ["kept.h5"]
    with open_film(vanishing) as seen, open_film("kept.h5") as kept:
        held, levels = list(kept), [frame.pixels for frame in seen]
        assert (kept.rate_hz, kept.metadata["camera"]) == (seen.rate_hz, "Played")
        assert all(np.array_equal(frame.pixels, levels[frame.index]) for frame in held)
        # a busy machine reports the loss later, so the film has more frames after it
        assert held[0].index == 0
        assert held[-1].index > 120
    # the recording includes the signal settings, so no option is needed
    assert "array 0: " in call("receive", "kept.h5").stdout


@pytest.mark.parametrize(("options", "says"), [
    (("--record", "kept.mkv"), "is recorded as HDF5, so its name ends in one of"),
    (("--record", "nowhere/kept.h5"), "name a file in a folder that exists"),
    (("--camera", "exposure=3"), "unknown setting 'exposure'; did you mean 'exposure_us'"),
    (("--duration", "0"), "setting 'duration_s': input should be greater than 0"),
    (("--truth", "a.npz"), "a live camera has no truth"),
    (("--crop", "0,0,4000,10"), "reaches beyond the frames of camera:played"),
])  # fmt: skip
def test_wrong_options(call: Call, film: Path, tmp_path: Path, options: tuple[str, str], says: str) -> None:
    assert says in failed(received(call, film, *options, "--output", "out"))
    assert names(tmp_path) == []


@pytest.mark.parametrize("option", [("--camera", "gain=3"), ("--duration", "3"), ("--record", "kept.h5")])
def test_options_of_cameras_are_not_for_recordings(call: Call, film: Path, option: tuple[str, str]) -> None:
    assert f"{option[0]} is for a live camera, such as camera:aravis" in failed(call("receive", film, *option))
    both = call("convert", film, "again.h5", "--camera", "gain=3", "--duration", "3")
    assert "--camera and --duration are for a live camera" in failed(both)


def test_a_cameras_film_can_be_converted(call: Call, film: Path, tmp_path: Path) -> None:
    asked = ("--crop", "0,0,80,60", "--camera", "Lost=40")
    says = succeeded(call("convert", f"camera:played:{film}", "taken.h5", *asked))
    counts = "camera: 319 frames, 1000.0 per second by the camera's clock; 1 lost in transfer"
    assert says.splitlines() == ["taken.h5: 319 frames", counts]
    with open_film(tmp_path / "taken.h5") as taken:
        assert [frame.index for frame in taken] == [k for k in range(320) if k != 40]
        assert (taken.width, taken.height) == (80, 60)


def test_sigterm_ends_the_recording_of_a_camera(film: Path, tmp_path: Path) -> None:
    command = ("--load", PLAYED, "convert", f"camera:played:{film}", "taken.h5", *ENDLESS)
    says = succeeded(interrupted_at(tmp_path, *command, title="converting", step=20, by=signal.SIGTERM))
    assert says.splitlines()[1].startswith("camera: ")
    with open_film(tmp_path / "taken.h5") as taken:
        assert f"taken.h5: {taken.frame_count} frames\n" in says


def test_cameras_and_missing_requirements_are_listed(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    found = json.loads(succeeded(call("cameras", "--json")))
    assert {"name": "camera:played:FILM", "text": "plays a film"} in found["cameras"]
    says = succeeded(call("cameras"))
    assert "camera:played:FILM" in says
    for kind, why in found["lacking"].items():
        assert f"camera:{kind}: {why}" in says
        assert any(cure in why for cure in ("install", "plug one in", "no camera answers", "give the address")), why
    assert "genicam" in found["lacking"]


def test_a_camera_is_probed(call: Call, film: Path) -> None:
    says = succeeded(call("probe", f"camera:played:{film}", "--preset", "static", "--frames", "230"))
    assert f"camera:played:{film}: 230 frames of 160x120 px" in says
    assert "array 0: upright" in says
