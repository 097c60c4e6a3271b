"""Invalid input gives a one-line error with a remedy on stderr, and leaves no output."""

import contextlib
import ctypes
import json
import os
import resource
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from cli_runs import SMALL, Call, failed, heliograph, lasting, names, succeeded
from film_checks import write_levels

from heliograph.cli import console
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings


@pytest.fixture(scope="module")
def stock(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create a folder with invalid files and a valid film."""
    folder = tmp_path_factory.mktemp("stock")
    for name, content in {
        "text.mkv": b"this is no film\n",
        "text.tif": b"this is no film\n",
        "bad.toml": b"a = [\n",
        "binary.toml": b"\xff\xfe\x00",
        "unknown.toml": b"[channel]\ndistanse_m = 3\n",
        "file": b"a file",
        "junction.toml": b"id = 7\ngroup = 1\n",
        "long": bytes(20_000_000),
        "empty": b"",
    }.items():
        (folder / name).write_bytes(content)
    os.mkfifo(folder / "pipe")
    changes = [part for part in SMALL if "=" in part] + ["channel.duration_s=0.25"]
    settings = load_settings("static", None, changes)
    write_film(folder / "a.mkv", settings, [{"high": [b"kept"]}], seed=1)
    whole = (folder / "a.mkv").read_bytes()
    (folder / "cut.mkv").write_bytes(whole[: int(len(whole) * 0.6)])
    write_film(folder / "other.mkv", load_settings("static", None, [*changes, "channel.duration_s=0.01"]), [{}], seed=2)
    (folder / "cut-short.mkv").write_bytes((folder / "other.mkv").read_bytes()[:-2000])
    write_levels(folder / "one.mkv", np.zeros((1, 120, 160), np.uint8))
    return folder


JUNCTION = Path(__file__).parents[2] / "examples" / "junction.toml"
S, LONGER = (" ".join(lasting(seconds)) for seconds in (0.01, 0.1))

BAD = {
    # films to read
    "receive {}/text.mkv --output out": "text.mkv is not a video",
    "receive {}/missing.mkv --output out": "there is no file", "receive {}/text.tif": "cannot be read as TIFF",
    # settings
    "simulate a.mkv --preset papre": "did you mean 'paper'", "presets papre": "did you mean 'paper'",
    "simulate a.mkv --set channel.distanse_m=3": "did you mean 'channel.distance_m'",
    "simulate a.mkv --set channel.distance_m=far": "channel.distance_m",
    f"simulate a.mkv {S} --set channel.duration_s=1e-5": "raise channel.duration_s",
    "simulate a.mkv --settings {}/bad.toml": "bad.toml: not valid TOML",
    "simulate a.mkv --settings /dev/zero": "longer than 1,048,576 bytes",
    "simulate a.mkv --settings {}/pipe": "a pipe that nobody writes to", "receive {}/pipe": "is a pipe or a device",
    "--load {}/pipe presets": "a pipe that nobody writes to",
    "simulate a.h5 --set channel.duration_s=3600 --set channel.camera.width=8192": "are free; write less",
    "transmit a.npy --packets 1000000000": "are free; write less",
    "transmit a.mkv --packets 100000000000": "are free; write less",
    "transmit a.bits --packets 1000000000": "are free; write less",
    f"simulate a.mkv {S} --high {{}}/pipe": "a pipe that nobody writes to",
    f"simulate a.mkv {S} --high /dev/zero": "send less",
    f"simulate a.mkv {S} --imu {{}}/pipe": "a pipe that nobody writes to",
    "simulate a.mkv --settings {}/binary.toml": "write TOML in UTF-8",
    "simulate a.mkv --settings {}/unknown.toml": "did you mean 'channel.distance_m'",
    "simulate a.mkv --settings {}/missing.toml": "No such file",
    "receive {}/a.mkv --receiver plane": "unknown receiver 'plane'; did you mean 'plain'?",
    # truth and output
    "receive {}/a.mkv --truth {}/text.mkv": "no truth file: those end in .truth.npz",
    "receive {}/a.mkv --truth {}/other.mkv.truth.npz": "is not the truth of",
    "receive {}/a.mkv --output {}/file": "cannot write", "receive {}/a.mkv --output {}/file/deeper": "cannot write",
    "demo --output {}/file": "cannot write",
    "demo --output d --set channel.duration_s=1e-5": "raise channel.duration_s",
    "reproduce fig5 --data {}/missing --output d": "has no driving/*.mp4",
    f"simulate {{}}/a.mkv {S} --high {{}}/a.mkv": "is read and would be written: give the output another name",
    f"simulate {{}}/a.mkv {S} --background {{}}/a.mkv": "is read and would be written",
    f"simulate {{}}/a.mkv {S} --low {{}}/a.mkv.truth.npz": "is read and would be written",
    "transmit {}/a.mkv --middle {}/a.mkv": "is read and would be written",
    f"simulate a.xyz {S}": "must end in one of .mkv", f"simulate a {S}": "must end in one of .mkv",
    f"simulate none/a.mkv {S}": "the folder none does not exist", f"simulate a.mkv {S} --crf 70 --codec h264": "crf",
    "transmit a.xyz": "must end in one of .npy, .csv", "transmit none/a.npy": "cannot write none/a.npy",
    "transmit a.mkv --slots": "use .nut",
    # recordings
    f"simulate a.mkv {S} --background {{}}/text.mkv": "not a video",
    f"simulate a.mkv {S} --set channel.background.kind=footage": "--background",
    f"simulate a.mkv {S} --imu {{}}/a.mkv": "no text", f"simulate a.mkv {S} --set channel.shake=imu": "--imu",
    # budgets
    "budget --candela -1": "setting 'candela': input should be greater than",
    "budget --vary foo": "write key=value,value or key=first:last:step",
    "serve {}/text.mkv --port 0": "is not a video that can be read",
    # messages
    f"simulate a.mkv {S} --high {{}}/missing": "cannot read", f"simulate a.mkv {S} --middle {{}}/long": "send less",
    "transmit a.npy --high {}/long": "send less", "transmit a.npy --file gone": "cannot read gone",
    "transmit a.npy --file {}/file --file-code magic": "cauchy, raptorq",
    "transmit a.npy --file {}/file --high x --middle x --low x": "leave out",
    "transmit a.npy --junction {}/junction.toml": "junction.toml: ",
    "transmit a.npy --junction none.toml": "settings none.toml: No such file or directory; check the path",
    "--load none.py presets": "cannot load none.py: No such file or directory; check the path",
    f"transmit a.npy --junction {JUNCTION} --high x": "leave out --high",
    # parts of frames
    "receive {}/a.mkv --crop 1,2,3": "a crop is x, y, width and height",
    "convert {}/a.mkv b.h5 --crop a,b,c,d": "--crop takes X,Y,WIDTH,HEIGHT in whole pixels, not 'a,b,c,d'",
    "probe {}/a.mkv --crop a,b": "--crop", "receive {}/a.mkv --bin 0": "squares of 1 to 16 pixels a side",
    "convert {}/a.mkv b.h5 --channel pink": "choose one of luma, red, green, blue",
    **{
        f"receive {{}}/a.mkv --truth {{}}/a.mkv.truth.npz {option}": "leave out --crop, --bin and --rotate, or --truth"
        for option in ("--rotate 180", "--crop 0,0,64,64", "--bin 2")
    },
    # positions of arrays
    "receive {}/one.mkv --corners 1,2,3": "--corners takes X,Y,X,Y,X,Y,X,Y in pixels, not '1,2,3'",
    "receive {}/one.mkv --corners a,b,c,d,e,f,g,h": "--corners takes",
    "receive {}/one.mkv --corners nan,0,9,0,9,9,0,9": "--corners takes",
    "receive {}/one.mkv --corners 0,0,90,90,90,0,0,90": "four corners one after the other around an area",
    "receive {}/one.mkv --receiver plain --corners 0,0,5,0,5,5,0,5": "set receive.detect.min_side_px",
    "receive {}/one.mkv --region 1,2,30": "--region takes X,Y,WIDTH,HEIGHT in whole pixels, not '1,2,30'",
    "receive {}/one.mkv --region 1,2,30,4.5": "--region takes",
    "receive {}/one.mkv --region 1,2,3,3": "receive.detect.region", "receive {}/one.mkv --region=": "--region takes",
    f"receive {{}}/one.mkv --region 1,2,1{'0' * 5000},9": "--region takes",
    "receive {}/one.mkv --receiver plain --region 500,0,40,40": "500,0,40,40 that was given lies beyond the frames",
    # signals
    "receive {}/a.mkv --truth {}/a.mkv.truth.npz --set signal.rate.high=0.5": "signal.rate.high is 0.5, but ",
    "receive {}/a.mkv --truth {}/a.mkv.truth.npz --set signal.data_pairs=24": "signal.data_pairs is 24, but ",
    # several films
    "receive a.h5 b.h5 --follow": "accept a single film",
    "receive a.h5 camera:genicam": "camera:genicam is a live camera: receive it separately",
    "receive camera:genicam --workers 1": "is a live camera: receive it separately",
    "receive a.h5 b/a.h5 --output out": "several films have the name a.h5",
    "receive a.h5 b.h5 --workers 2 --scheduler tcp://127.0.0.1:1": "not both",
    "receive a.h5 b.h5 --set receive.receiver=nobody": "nobody",
    # diagnoses
    "probe {}/a.mkv --set receive.nothing=1": "receive.nothing", "probe {}/a.mkv --receiver nobody": "nobody",
    "probe {}/a.mkv --output {}/file": "cannot write",
    # data sets
    "dataset a --splits many": "--splits takes TRAIN,VALIDATION,TEST in whole shares, not 'many'",
    "dataset a --vary channel.distnce_m=3": "did you mean 'channel.distance_m'?",
    "dataset a --vary channel.distance_m=3 --vary channel.distance_m=4": "is varied twice",
    "dataset a --set channel.background.kind=footage": "give it by --background VIDEO",
    "dataset a --background none.mp4": "there is no file none.mp4",
    "dataset a --packets 10000 --films 2000 --set channel.camera.width=4000": "are free",
    # measurements
    "measure scenes nowhere": "there is no scene nowhere; there are upright",
    "measure scenes upright --at near": "'near' is no list of numbers; separate numbers by commas",
    "measure scenes upright --receiver sift --at 50 --workers 1": "receive.receiver",
    "measure repeated-packets --layer top": "unknown layer 'top'; choose from high, middle, low",
    "measure known-channel --brightness 1,,2": "'1,,2' is no list of numbers",
    "measure drives none.mp4 --imu none.csv": "none.mp4",
    "measure lossy none.mp4 out.mp4": "there is no truth file none.mp4.truth.npz",
    # pages
    "serve missing.mkv": "there is no file missing.mkv", "serve --certificate a.pem": "HTTPS requires both",
    "serve --port 0 --certificate a.pem --key b.pem": "cannot use the certificate a.pem and its key",
    "serve --port 0 --set signal.side=7": "signal.side",
}  # fmt: skip

WRONG_USAGE = {
    "receive": "Missing argument", "recieve a.mkv": "No such command 'recieve'",
    "receive a.mkv --outptu x": "No such option", "receive a.mkv --load x.py": "--load FILE stands before the command",
    "receive a.mkv --output": "requires an argument", "convert a.mkv b.mkv c.mkv": "unexpected extra argument",
    "simulate a.mkv --seed -1": "--seed", "simulate a.mkv --seed x": "--seed",
    "transmit a.npy --identity 30": "--identity", "transmit a.npy --packets 0": "--packets",
    "probe a.mkv --frames 0": "--frames", "measure nothing": "heliograph measure --help",
}  # fmt: skip


@pytest.mark.parametrize(
    ("line", "said"),
    [
        *BAD.items(), *WRONG_USAGE.items(),
        pytest.param("probe {}/cut-short.mkv", "ends in the middle", marks=pytest.mark.slow),
        pytest.param("sweep --scheduler nowhere --output d", "no address of a scheduler", marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_bad_input_is_a_line_and_leaves_no_file(line: str, said: str, stock: Path, tmp_path: Path, call: Call) -> None:
    is_usage, before = line in WRONG_USAGE, names(stock)
    text = failed(call(*line.replace("{}", str(stock)).split()), status=2 if is_usage else 1)
    assert said in text
    assert not is_usage or "--help" in text
    assert (list(tmp_path.iterdir()), names(stock)) == ([], before)


@contextlib.contextmanager
def limited(kind: int, size: int) -> Iterator[None]:
    """Limit a resource of this process."""
    before = resource.getrlimit(kind)
    resource.setrlimit(kind, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(kind, before)


@pytest.mark.slow
def test_too_little_memory_is_reported(tmp_path: Path, call: Call) -> None:
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    large = ["--set", "channel.camera.width=8192", "--set", "channel.camera.height=8192"]
    with limited(resource.RLIMIT_AS, used + (1 << 30)):
        said = failed(call("simulate", "a.mkv", *large, "--set", "channel.duration_s=0.01"))
    assert "not enough memory" in said or "Cannot allocate memory" in said
    assert names(tmp_path) == []


@pytest.mark.parametrize("line", [f"simulate a.mkv {LONGER}", f"simulate a.h5 {LONGER}", "transmit a.npy"])
@pytest.mark.slow
def test_a_file_above_the_size_limit_is_removed(line: str, tmp_path: Path, call: Call) -> None:
    with limited(resource.RLIMIT_FSIZE, 20_000):
        run = call(*line.split())
    assert "cannot write" in failed(run)
    assert names(tmp_path) == []


@pytest.mark.slow
def test_a_cut_film_gives_its_results_and_then_the_error(stock: Path, tmp_path: Path, call: Call) -> None:
    run = call("receive", stock / "cut.mkv", "--output", "out", "--truth", stock / "a.mkv.truth.npz")
    assert "ends in the middle, after 1" in failed(run)
    assert "message out/array-0-high-0.bin" in run.stdout
    assert "50-55" in run.stdout
    assert (tmp_path / "out/array-0-high-0.bin").read_bytes() == b"kept"
    assert names(tmp_path / "out") == ["array-0-high-0.bin", "packets.jsonl", "summary.json"]
    assert (tmp_path / "out/packets.jsonl").read_text().count("\n") >= 1
    # a truncated film keeps earlier messages
    (tmp_path / "out/array-3-low-1.bin").write_bytes(b"another film's")
    run = call("receive", stock / "cut.mkv", "--output", "out", "--json")
    assert (tmp_path / "out/array-3-low-1.bin").read_bytes() == b"another film's"
    assert "ends in the middle, after 1" in json.loads((tmp_path / "out/summary.json").read_text())["error"]
    report = json.loads(run.stdout)
    assert 100 < report["frames"] < 200
    assert report["arrays"][0]["layers"]["high"]["ok"] >= 1


def test_a_film_of_one_frame_is_too_short(stock: Path, call: Call, tmp_path: Path) -> None:
    run = call("receive", stock / "one.mkv", "--output", "out")
    assert "has 1 frame; a packet takes 100: give a film, a stack, or the folder of all its pictures" in failed(run)
    assert "1 frame in" in run.stdout
    assert "no array found" in run.stdout
    assert names(tmp_path / "out") == ["packets.jsonl", "summary.json"]


def test_a_failure_keeps_earlier_results_and_films(stock: Path, call: Call, tmp_path: Path) -> None:
    for name in ("packets.jsonl", "a.mkv"):
        (tmp_path / name).write_text("earlier")
    failed(call("receive", stock / "text.mkv", "--output", tmp_path))
    failed(call("simulate", "a.mkv", *lasting(0.2), "--background", stock / "cut.mkv",
                "--set", "channel.camera.fps=1e6"))  # fmt: skip
    assert {name: (tmp_path / name).read_text() for name in names(tmp_path)} == {
        "a.mkv": "earlier", "packets.jsonl": "earlier"
    }  # fmt: skip


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """Mount a 64 kB disk."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)]
    made = subprocess.run(command, capture_output=True, check=False)
    if made.returncode:
        pytest.skip(f"a small disk cannot be mounted here: {made.stderr.decode().strip()}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fill(disk: Path, left: int) -> None:
    free = os.statvfs(disk).f_bavail * os.statvfs(disk).f_frsize
    with (disk / "filler").open("ab") as file:
        file.write(bytes(max(0, free - left)))


def says_full(text: str) -> bool:
    """Return True if the error reports a full disk, for the film or for the truth."""
    return "disk full" in text or "No space left on device; make room" in text


@pytest.mark.slow
def test_a_full_disk_keeps_no_half_file_and_shows_the_results(disk: Path, stock: Path, call: Call) -> None:
    assert says_full(failed(call("simulate", disk / "a.mkv", *lasting(0.1))))
    assert names(disk) == []
    assert "0.1 MB are free" in failed(call("transmit", disk / "a.npy", "--packets", "9"))
    assert says_full(failed(call("transmit", disk / "a.mkv", "--packets", "9")))
    assert names(disk) == []
    fill(disk, 16384)
    assert says_full(failed(call("demo", "--output", disk / "d", *lasting(0.1))))
    assert names(disk) == ["filler"]
    fill(disk, 4096)
    run = call("receive", stock / "a.mkv", "--output", disk / "out")
    assert "No space left" in failed(run)
    assert "array 0: 2 packets" in run.stdout
    assert "message" in run.stdout
    assert names(disk) == ["filler", "out/array-0-high-0.bin"]
    assert (disk / "out/array-0-high-0.bin").read_bytes() == b"kept"
    fill(disk, 0)
    assert "No space left" in failed(call("receive", stock / "a.mkv", "--output", disk / "new"))


def humbled() -> None:
    """Drop root's file permissions: CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH."""
    for capability in (1, 2) if os.geteuid() == 0 else ():
        ctypes.CDLL(None).prctl(24, capability, 0, 0, 0)  # PR_CAPBSET_DROP


@pytest.mark.slow
def test_a_folder_that_may_not_be_written_is_reported(stock: Path, tmp_path: Path) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o500)
    said = failed(heliograph("receive", stock / "a.mkv", "--output", closed, cwd=tmp_path, prepare=humbled))
    assert "Permission denied" in said
    assert "make room" not in said
    assert names(tmp_path) == []


@pytest.mark.slow
def test_closed_streams_end_a_command_before_any_work(tmp_path: Path) -> None:
    assert "standard output is closed" in failed(heliograph("presets", cwd=tmp_path, prepare=lambda: os.close(1)))
    unheard = heliograph("recieve", cwd=tmp_path, prepare=lambda: os.close(2))
    assert (unheard.returncode, unheard.stderr) == (2, "")


@pytest.mark.slow
def test_no_array_in_sight_is_a_result_not_a_fault(call: Call, tmp_path: Path) -> None:
    succeeded(call("simulate", "a.mkv", *lasting(0.12), "--set", "channel.arrays.0.x_m=30"))
    run = call("receive", "a.mkv", "--truth", "a.mkv.truth.npz")
    assert (run.returncode, run.stderr) == (console.NO_ARRAY, "")
    assert "no array found" in run.stdout
