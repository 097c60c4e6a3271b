"""Behaviour of each command, and its JSON contract."""

import base64
import io
import json
import os
import re
import socket
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from cli_runs import COMMAND, Call, failed, heliograph, lasting, names, succeeded, within
from waiting import HANG_S

import heliograph as heliograph_package
from heliograph.cli import console, main
from heliograph.link.settings import PRESETS
from heliograph.media import open_film

pytestmark = pytest.mark.slow

HIGH = b"brake\x00\xff"
MESSAGES = {"high": HIGH, "middle": b"detour " * 10, "low": bytes(range(70))}


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    for name, data in MESSAGES.items():
        (folder / name).write_bytes(data)
    sent = [word for layer in MESSAGES for word in (f"--{layer}", layer)]
    out = within(folder, "simulate", "a.mkv", *lasting(0.2), *sent, "--seed", "5")
    assert succeeded(out) == "a.mkv: 200 frames; truth in a.mkv.truth.npz\n"
    assert names(folder) == ["a.mkv", "a.mkv.truth.npz", "high", "low", "middle"]
    return folder / "a.mkv"


def test_a_reception_is_followed_by_lines_datagrams_and_words(film: Path, call: Call) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(HANG_S)
        address = f"udp://127.0.0.1:{listener.getsockname()[1]}"
        out = call("receive", film, "--receiver", "plain", "--follow", "--verbose", "--send", address)
        rows = [json.loads(line) for line in out.stdout.splitlines()]
        assert [json.loads(listener.recv(1 << 16)) for _ in rows] == rows
    assert out.returncode == 0
    assert [row["event"] for row in rows if row["event"] != "message"] == ["found", *2 * ["packet"], "end"]
    (high,) = (row for row in rows if row["event"] == "message" and row["layer"] == "high")
    assert (base64.b64decode(high["data"]), rows[-1]["arrays"][0]["packets"]) == (HIGH, 2)
    found = r"^0\.000 s: array 0 found (49|50)\.\d m away, moving by \d+ px/s in the image, upright; identity uncertain"
    assert re.search(found, out.stderr, re.M)
    assert "message 0 of the high layer is whole, 7 bytes" in out.stderr


def test_messages_are_printed_as_text_or_hexadecimal(tmp_path: Path, call: Call) -> None:
    """Print text as text and other data as leading bytes; escape terminal control characters."""
    coloured = b"brake \x1b[31m"
    sent = ("--high", f"text:{coloured.decode()}", "--middle", f"text:{'x' * 100}")
    succeeded(call("simulate", "a.h5", *lasting(0.22), *sent))
    said = succeeded(call("receive", "a.h5", "--preset", "static")).splitlines()
    high = f"array 0, high, message 0: 11 bytes, {coloured.hex()}"
    assert said[:2] == ["receiver soft: 1000 frames/s, 1000 patterns/s", high]
    assert f"array 0, middle, message 0: 100 bytes, '{'x' * 57}...'" in said


def test_a_text_or_standard_input_is_sent(tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """An argument that looks like a file name is a file, unless prefixed with "text:"."""
    (tmp_path / "words").write_bytes(b"of a file")
    said = [("red light", b"red light"), ("text:a.txt", b"a.txt"), ("words", b"of a file")]
    for number, (given, _) in enumerate(said):
        succeeded(call("transmit", f"{number}.npy", "--high", given, "--packets", "1"))
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"red light")))
    succeeded(call("transmit", "3.npy", "--high", "-", "--packets", "1"))
    for number, data in enumerate([*(data for _, data in said), b"red light"]):
        assert np.array_equal(np.load(tmp_path / f"{number}.npy"), heliograph_package.encode({"high": data})[:100])


def test_receive_writes_messages_packets_and_summary_and_counts_errors(film: Path, tmp_path: Path, call: Call) -> None:
    said = succeeded(call("receive", film, "--receiver", "plain", "--output", "out", "--truth", f"{film}.truth.npz"))
    assert "200 frames in " in said
    (line,) = [line for line in said.splitlines() if line.strip().startswith("50-55")]
    high, middle = "< 1.5e-03 of 2048 0/2", "< 7.3e-04 of 4096 0/4"
    assert line.split() == f"50-55 m {high} {middle} {high}".split()
    assert "packets that were not sent: 0\naccepted codewords that were not sent: 0" in said
    assert re.search(r"array 0: 2 packets, frames 0 to 199, (49\.\d|50\.\d) m to (49\.\d|50\.\d) m away\n", said)
    assert "message out/array-0-high-0.bin" in said
    out = tmp_path / "out"
    messages = {path.name: path.read_bytes() for path in out.glob("*.bin")}
    assert messages == {f"array-0-{layer}-0.bin": data for layer, data in MESSAGES.items()}
    assert names(out) == sorted([*messages, "packets.jsonl", "summary.json"])
    log = [json.loads(line) for line in (out / "packets.jsonl").read_text().splitlines()]
    assert [(row["first_frame"], row["status"]) for row in log] == [(0, "ok"), (100, "ok")]
    assert json.loads((out / "summary.json").read_text())["frames"] == 200


def test_json_is_one_object_with_the_documented_fields(film: Path, tmp_path: Path, call: Call) -> None:
    out = succeeded(call("receive", film, "--json", "--truth", f"{film}.truth.npz"))
    assert out.count("\n") == 1
    report = json.loads(out)
    untrue = json.loads(succeeded(call("receive", film, "--json")))
    assert not {"errors", "false_packets", "false_codewords"} & set(untrue)
    assert (report["false_packets"], report["false_codewords"], report["frames"]) == (0, 0, 200)
    assert report["frames_per_second"] == pytest.approx(200 / report["seconds"], rel=0.01)
    (array,) = report["arrays"]
    layers = array["layers"]
    assert (list(layers), layers["high"]) == (list(MESSAGES), {"ok": 2, "failed": 0, "bytes": 2 * len(HIGH)})
    distances = {"first_distance_m": pytest.approx(50, abs=0.5), "last_distance_m": pytest.approx(50, abs=0.5)}
    assert array == {"id": 0, "first_frame": 0, "last_frame": 199, "packets": 2, "layers": layers, **distances}
    (row,) = report["errors"]
    assert (row["from_m"], row["to_m"]) == (50.0, 55.0)
    for layer, codewords in (("high", 2), ("middle", 4), ("low", 2)):
        expected = {"bits": 1024 * codewords, "errors": 0, "codewords": codewords, "codeword_errors": 0}
        assert row[layer] | expected == row[layer]
    assert names(tmp_path) == []


def test_settings_come_from_preset_file_and_assignments_in_this_order(tmp_path: Path, call: Call) -> None:
    (tmp_path / "my.toml").write_text("[channel]\nduration_s = 0.02\n[channel.camera]\nwidth = 96\nheight = 48\n")
    succeeded(call("simulate", "a.mkv", "--preset", "static", "--settings", "my.toml",
                         "--set", "channel.camera.height=64"))  # fmt: skip
    with open_film(tmp_path / "a.mkv") as film:
        assert (film.width, film.height, len(list(film))) == (96, 64, 20)


def test_a_background_and_recorded_motion_are_used(film: Path, tmp_path: Path, call: Call) -> None:
    rows = [f"{k * 0.01:.2f},0.01,{0.2 * np.sin(k):.4f},0,8" for k in range(50)]
    (tmp_path / "imu.csv").write_text("t_s,gyro_fwd_rad_s,gyro_right,gyro_down,speed_m_s\n" + "\n".join(rows))
    for name, extra in (("b.mkv", ()), ("c.mkv", ("--imu", "imu.csv"))):
        succeeded(call("simulate", name, *lasting(0.02), "--background", film, *extra))
    pictures = []
    for name in ("b.mkv", "c.mkv"):
        with open_film(tmp_path / name) as source:
            pictures.append(np.stack([frame.pixels for frame in source]))
    assert not np.array_equal(pictures[0], pictures[1])


def test_transmit_writes_patterns_as_numbers(tmp_path: Path, call: Call) -> None:
    out = succeeded(call("transmit", "a.npy", "--packets", "2", "--identity", "9"))
    assert out == "a.npy: 200 patterns of 1 ms, 0.2 s\n"
    levels = np.load(tmp_path / "a.npy")
    assert (levels.shape, levels.dtype, levels.max()) == ((200, 16, 16), np.uint8, 4)
    assert (levels[0::2] + levels[1::2] == 4).all(), "each pattern is followed by its inverse"
    out = succeeded(call("transmit", "a.csv", "--packets", "2", "--identity", "9", "--slots"))
    assert out == "a.csv: 800 slots of 0.25 ms, 0.2 s\n"
    table = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)
    assert np.array_equal(table[:, 1:], np.reshape(list(heliograph_package.open_slots(tmp_path / "a.csv")), (800, -1)))
    assert table[:, 0] == pytest.approx(np.arange(800) * 0.25e-3)
    assert (table[:, 1:].reshape(200, 4, 16, 16).sum(1) == levels).all()
    assert names(tmp_path) == ["a.csv", "a.npy"]


def test_transmit_writes_files_for_drivers(tmp_path: Path, call: Call) -> None:
    order = ("--packets", "1", "--set", "signal.slot_order=[0, 2, 1, 3]")
    succeeded(call("transmit", "a.npy", "--slots", *order))
    for name in ("a.bits", "a.h", "a.hub75", "a.shift"):
        assert succeeded(call("transmit", name, *order)) == f"{name}: 400 slots of 0.25 ms, 0.1 s\n"
        slots = heliograph_package.open_slots(tmp_path / name)
        assert np.array_equal(list(slots), np.load(tmp_path / "a.npy"))
        assert (slots.form.side, slots.form.slots_per_pattern, slots.form.slot_ns) == (16, 4, 250_000)
    assert names(tmp_path) == ["a.bits", "a.h", "a.hub75", "a.npy", "a.shift"]


def test_transmit_writes_a_film_for_a_screen(tmp_path: Path, call: Call) -> None:
    said = succeeded(call("transmit", "a.mkv", "--packets", "1", "--preset", "two-arrays"))
    assert said.startswith("Caution: on a display this film flashes")
    with open_film(tmp_path / "a.mkv") as film:
        frames = [frame.pixels for frame in film]
    assert (len(frames), frames[0].shape) == (100, (256, 256))
    assert set(np.unique(frames[50])) <= {0, 63, 127, 191, 255}


def test_a_converted_film_is_read_like_its_source(film: Path, tmp_path: Path, call: Call) -> None:
    assert succeeded(call("convert", film, "b.h5")) == "b.h5: 200 frames\n"
    truth = ("--truth", f"{film}.truth.npz", "--json")
    ours, theirs = (json.loads(succeeded(call("receive", path, *truth))) for path in ("b.h5", film))
    assert ours["errors"] == theirs["errors"]
    assert succeeded(call("convert", "b.h5", "c.avi")).startswith("c.avi: 200 frames; gray levels differ slightly")
    assert "is read and would be written" in failed(call("convert", "b.h5", "b.h5"))


def test_budget_shows_image_range_and_flicker(call: Call) -> None:
    small = ("--set", "signal.side=8", "--vary", "channel.distance_m=20,60")
    text = succeeded(call("budget", *small))
    rows = [line.split() for line in text.splitlines()]
    assert (rows[0][:3], [row[0] for row in rows[1:3]]) == (["channel.distance_m", "m", "px/LED"], ["20", "60"])
    soft = [["soft", mode, layer] for mode in ("paired", "single") for layer in MESSAGES]
    assert [row[:3] for row in rows if row[:1] == ["soft"]] == soft
    assert "flicker, paired: the light of the array is even over 2 ms (500 Hz), of an LED over 2 ms (500 Hz)" in text
    near, far = json.loads(succeeded(call("budget", *small, "--candela", "0.5", "--json")))
    assert [point["settings"] for point in (near, far)] == [{"channel.distance_m": 20}, {"channel.distance_m": 60}]
    assert near["spot"]["electrons_led"] == pytest.approx(9 * far["spot"]["electrons_led"], rel=0.1)
    assert {layer["receiver"] for layer in near["layers"]} == {"plain", "soft"}
    assert far["flicker"]["single"]["led_period_s"] > 0.01
    assert (near["candela"], near["notes"]) == (0.5, [])


def test_budget_warns_of_saturation_and_prints_similar_notes_once(call: Call) -> None:
    bright = ("budget", "--set", "signal.side=8", "--candela", "9")
    text = succeeded(call(*bright, "--set", "channel.distance_m=30"))
    assert "note: the array saturates" in text
    assert "reads to" not in text
    aside = ("--set", "channel.arrays.0.x_m=9", "--vary", "channel.distance_m=20,30,40")
    (note,) = [line for line in succeeded(call(*bright, *aside)).splitlines() if "not in the" in line]
    assert note.startswith("note: at 20 m the array is not in the picture")
    assert note.endswith("(similar at 2 more)")


def test_presets_are_listed_and_printed(tmp_path: Path, call: Call) -> None:
    listed = succeeded(call("presets")).splitlines()
    assert [line.split()[0] for line in listed] == list(PRESETS)
    assert json.loads(succeeded(call("presets", "--json"))).keys() == PRESETS.keys()
    text = succeeded(call("presets", "night"))
    tree = json.loads(succeeded(call("presets", "night", "--json")))
    assert tomllib.loads(text)["channel"]["emitter"] == tree["channel"]["emitter"]
    assert tree["channel"]["emitter"]["all_on"] == 0.2


def test_demo_counts_codewords_and_writes_a_report(tmp_path: Path, call: Call) -> None:
    first, *lines, last = succeeded(call("demo", "--output", "d", *lasting(0.1))).splitlines()
    assert first == "d/drive.mp4: a film of 100 frames, about 1 MB"
    assert "array 0: 1 packet; codewords read: high 1/1" in "\n".join(lines)
    assert last == "open d/report.html, and d/replay.html to look at every moment"
    written = {"report.html", "replay.html", "drive.mp4", "drive.mp4.truth.npz", "array-0-high-0.txt"}
    assert written <= set(names(tmp_path / "d"))


def test_the_script_and_python_run_the_command(tmp_path: Path) -> None:
    version = f"heliograph {heliograph_package.__version__}\n"
    assert succeeded(heliograph("--version", cwd=tmp_path)) == version
    wrong = subprocess.run([sys.executable, "-m", "heliograph", "simulat"], capture_output=True, text=True, check=False)
    assert wrong.stderr.startswith("heliograph: No such command 'simulat'. Did you mean 'simulate'?")
    assert wrong.stderr.endswith("see 'heliograph --help'\n")


@pytest.mark.parametrize(("words", "found"), [
    ("heliograph si", "simulate"), ("heliograph receive --tr", "--truth"), ("heliograph demo --preset t", "two-arrays"),
    ("heliograph presets mo", "motorway"), ("heliograph receive film.h5 --receiver so", "soft"),
])  # fmt: skip
def test_shells_complete_words_and_names(words: str, found: str, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("_HELIOGRAPH_COMPLETE", "complete_bash")
    monkeypatch.setenv("COMP_WORDS", words)
    monkeypatch.setenv("COMP_CWORD", str(len(words.split()) - 1))
    run = call()
    assert (run.stdout.split(), run.stderr) == ([found], "")


def test_long_lines_wrap_on_terminals_only(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    text = "fig13    holds    " + "0 of 1000 codewords, " * 80
    console.say_prose(text)
    assert capsys.readouterr().out == text + "\n"
    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "80")
    console.say_prose(text)
    wrapped = capsys.readouterr().out
    assert max(map(len, wrapped.splitlines())) < 80
    assert wrapped.split() == text.split()


def test_a_long_message_is_shortened_in_the_middle(capsys: pytest.CaptureFixture[str]) -> None:
    console.complain(f"unknown setting '{'x' * 5000}'; did you mean 'y'?")
    line = capsys.readouterr().err
    assert len(line) < 640
    assert line.startswith("heliograph: unknown setting 'xxx")
    assert line.endswith("did you mean 'y'?\n")


def test_help_and_no_arguments(call: Call) -> None:
    for command, text in main.COMMANDS.items():
        assert main.load_command(command).help.startswith(text)
    assert "simulate" in succeeded(call("--help"))
    told = " ".join(succeeded(call("receive", "--help")).split())
    assert "--truth" in told
    assert "screen" in told.partition("--receiver")[2].partition("--")[0]
    assert "overrides the preset. --settings and --set override the note" in told
    run = call()
    assert run.returncode == 2
    assert "Usage: heliograph" in run.stderr


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize("stream", [Terminal, io.StringIO])
def test_progress_is_shown_on_a_terminal_only(stream: type[io.StringIO], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", error := stream())
    with console.progress("receiving", 31) as note:
        for done in (1, 20, 921):  # the film has more frames than claimed
            note(done)
    shown = stream is Terminal
    assert ("receiving" in error.getvalue(), "921/921" in error.getvalue()) == (shown, shown)


def test_a_sweep_shows_counts_intervals_and_points_on_a_terminal(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", terminal := Terminal())
    vary = ("--vary", "channel.distance_m=40,70", "--set", "signal.data_pairs=8", "--max-codewords", "4")
    lines = call("sweep", *vary, "--workers", "1").stdout.splitlines()
    assert "2 of 2 points" in terminal.getvalue()
    assert "100%" in terminal.getvalue()
    assert [line.split()[:4] for line in (*lines[:4], lines[6])] == [
        ["channel.distance_m", "layer", "wrong", "of"], ["40", "high", "0", "4"], ["40", "middle", "0", "8"],
        ["40", "low", "0", "4"], ["70", "low", "4", "4"],
    ]  # fmt: skip
    assert "< 7.5e-01" in lines[1]
    assert " to " not in lines[1]
    assert "1.0e+00 (4.7e-01 to 1.0e+00)" in lines[6]


def test_a_closed_pipe_ends_a_process_silently() -> None:
    reader, writer = os.pipe()
    os.close(reader)
    run = subprocess.run([*COMMAND, "presets"], stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (run.returncode, run.stderr) == (1, b"")


def test_the_note_of_a_film_gives_the_signal_and_differing_settings_are_reported(tmp_path: Path, call: Call) -> None:
    (tmp_path / "tune.toml").write_text("[receive.decode]\niterations = 4\n")
    (tmp_path / "low.toml").write_text("[signal.rate]\nlow = 0.5\n")
    succeeded(call("simulate", "a.mkv", *lasting(0.14), "--set", "signal.data_pairs=64"))
    run = call("receive", "a.mkv", "--json", "--settings", "tune.toml")
    assert json.loads(succeeded(run))["arrays"][0]["packets"] == 1
    run = call("receive", "a.mkv", "--json", "--settings", "low.toml", "--set", "signal.rate.high=0.4")
    assert run.returncode == 0
    assert run.stderr.startswith("heliograph: not as the film's note says: signal.rate.high=0.4 instead of 0.333")
    assert run.stderr.count("\n") == 1
    assert "signal.rate.low=0.5 instead of 0.333" in run.stderr
    (array,) = json.loads(run.stdout)["arrays"]
    assert {name: bool(tally["ok"]) for name, tally in array["layers"].items()} == {
        "high": False, "middle": True, "low": False
    }  # fmt: skip


def test_overlong_packets_are_uncertain(film: Path, tmp_path: Path, call: Call) -> None:
    """With overlong packets, every second packet has no header and no valid codeword."""
    run = call("receive", film, "--output", "out", "--set", "signal.data_pairs=64")
    assert run.returncode == 3
    assert "detection" not in run.stdout.splitlines()[0]
    assert "\nno array found: 1 detection without a decoded codeword\n" in run.stdout
    assert "uncertain, no codeword decoded: array 0: 1 packet" in run.stdout
    log = [json.loads(line) for line in (tmp_path / "out/packets.jsonl").read_text().splitlines()]
    assert [(row["status"], row["uncertain"]) for row in log] == [("crc_fail", True)]
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    assert (summary["arrays"], [(array["id"], array["packets"]) for array in summary["uncertain"]]) == ([], [(0, 1)])


def test_a_printed_preset_explains_each_setting_and_can_be_read(tmp_path: Path, call: Call) -> None:
    printed = succeeded(call("presets", "two-arrays"))
    settings = [line for line in printed.splitlines() if " =" in line]
    assert all("  # " in line for line in settings)
    assert "# min_side_px =" in printed  # unset, hence commented out
    (tmp_path / "two.toml").write_text(printed)
    again = call("sweep", "--settings", "two.toml", "--vary", "nothing=1")
    assert "unknown setting 'nothing'" in again.stderr
