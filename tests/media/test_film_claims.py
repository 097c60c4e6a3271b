"""Films with impossible claims raise a clear error; timestamps in decoding order are corrected."""

import math
import os
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import h5py
import numpy as np
import pytest

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import create_film, open_film
from heliograph.media.record import FilmRecord

COUNT = 5
TIMES = np.arange(COUNT) / 1000


def hdf5(path: Path, times: Any = TIMES, frames: Any = None, **attributes: Any) -> Path:
    with h5py.File(path, "w") as file:
        file["frames"] = np.zeros((COUNT, 8, 8), np.uint8) if frames is None else frames
        file["times_s"] = times
        for name, value in attributes.items():
            file.attrs[name] = value
    return path


def refused(path: Path) -> tuple[int, str]:
    """Return the number of frames before the error, and the error."""
    got: list[Frame] = []
    with pytest.raises(MediaError) as caught, open_film(path) as film:
        got.extend(film)
    assert "\n" not in str(caught.value)
    return len(got), str(caught.value)


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf, 1e18])
def test_a_time_that_is_none_ends_the_film_after_the_frames_before(tmp_path: Path, wrong: float) -> None:
    times = TIMES.copy()
    times[3] = wrong
    count, says = refused(hdf5(tmp_path / "a.h5", times))
    assert count == 3
    assert "after 3 whole frames: times are in seconds" in says


@pytest.mark.parametrize("times", [np.array([b"a"] * COUNT), ["a"] * COUNT, TIMES * 1j, np.zeros(COUNT, bool)], ids=str)
def test_times_are_numbers(tmp_path: Path, times: Any) -> None:
    assert "is not a film: expected 'frames'" in refused(hdf5(tmp_path / "a.h5", times))[1]


def test_times_that_no_double_holds(tmp_path: Path) -> None:
    times = TIMES.astype(np.longdouble)
    times[1] = np.finfo(np.longdouble).max
    assert "a frame at inf s after 1 whole frames" in refused(hdf5(tmp_path / "a.h5", times))[1]


def test_texts_that_lie_nowhere_do_not_hang(tmp_path: Path) -> None:
    """HDF5 would loop forever at the end of the heap, on an object of length zero."""
    path = tmp_path / "a.h5"
    with create_film(path, width=16, height=16, rate_hz=1000, metadata={"a": "b"}) as film:
        film.write(Frame(0, 0.0, np.zeros((16, 16), np.uint8)))
    data = bytearray(path.read_bytes())
    heap = data.index(b"GCOL")
    length = int.from_bytes(data[heap + 24 : heap + 32], "little")
    free = heap + 32 + (length + 7) // 8 * 8
    data[free : free + 16] = bytes(16)
    path.write_bytes(data)
    assert "damaged where its texts lie" in refused(path)[1]


def test_a_text_whose_type_is_damaged_does_not_crash(tmp_path: Path) -> None:
    """HDF5 would read a variable-length type with an invalid base type and abort the process."""
    path = tmp_path / "a.h5"
    with create_film(path, width=16, height=16, rate_hz=1000, metadata={"a": "b"}) as film:
        film.write(Frame(0, 0.0, np.zeros((16, 16), np.uint8)))
    data = bytearray(path.read_bytes())
    kind = data.index(b"metadata\0") + 17  # after the name, padded to 16 bytes, and the class
    assert data[kind - 1 : kind + 1] == b"\x19\x01"  # version 1, variable-length string
    data[kind] = 2
    path.write_bytes(data)
    with open_film(path) as film:
        assert film.metadata == {}


@pytest.mark.parametrize("name", ["rate_hz", "bits"])
def test_an_attribute_that_is_a_list_of_any_length_is_no_number(tmp_path: Path, name: str) -> None:
    held = np.empty(1, h5py.vlen_dtype(np.int64))
    held[0] = np.array([8])
    path = hdf5(tmp_path / "a.h5")
    with h5py.File(path, "a") as file:
        file.attrs.create(name, held, dtype=held.dtype)
    assert f"attribute '{name}' is a list, not" in refused(path)[1]


@pytest.mark.parametrize("rate", [-1.0, math.nan, math.inf, 1e300, 1e-300, 1e7, "fast", [1, 2], 1j], ids=str)
def test_a_rate_that_no_film_has(tmp_path: Path, rate: Any) -> None:
    assert "attribute 'rate_hz' is" in refused(hdf5(tmp_path / "a.h5", rate_hz=rate))[1]


@pytest.mark.parametrize("times", [np.zeros(COUNT), TIMES[::-1]], ids=["still", "falling"])
@pytest.mark.parametrize("rate", [{}, {"rate_hz": 1000.0}], ids=str)
def test_times_that_do_not_rise(tmp_path: Path, times: Any, rate: dict[str, float]) -> None:
    path = hdf5(tmp_path / "a.h5", times, **rate)
    assert "times_s do not rise; write the time of each frame" in refused(path)[1]
    with pytest.raises(MediaError, match="times_s do not rise"):
        open_film(path, rate_hz=1000.0)


@pytest.mark.parametrize("unit", [1e3, 1e6, 1e9, 1e-3])
def test_times_in_another_unit_than_the_rate(tmp_path: Path, unit: float) -> None:
    path = hdf5(tmp_path / "a.h5", TIMES * unit, rate_hz=1000.0)
    assert "write times_s in seconds" in refused(path)[1]
    with open_film(path, rate_hz=1000.0) as film:
        assert film.claimed_hz == 1000.0


def test_lost_frames_do_not_belie_the_rate(tmp_path: Path) -> None:
    with open_film(hdf5(tmp_path / "a.h5", TIMES * 3, rate_hz=1000.0)) as film:
        assert [frame.index for frame in film] == [0, 3, 6, 9, 12]


@pytest.mark.parametrize("bits", [-1, 7, 9, 99, 10**18, "x", [8, 8], 8.5, math.nan], ids=str)
def test_bits_that_no_film_has(tmp_path: Path, bits: Any) -> None:
    assert "attribute 'bits' is" in refused(hdf5(tmp_path / "a.h5", bits=bits))[1]


def test_metadata_of_any_depth_are_somebody_else_s(tmp_path: Path) -> None:
    deep = hdf5(tmp_path / "a.h5", metadata="[" * 20_000 + "]" * 20_000)
    with open_film(deep) as film:
        assert film.metadata == {}
        assert len(list(film)) == COUNT
    assert FilmRecord.loads('{"a":' * 20_000 + "1" + "}" * 20_000) is None


def to_itself(file: h5py.File) -> None:
    file["frames"] = h5py.SoftLink("/frames")


def to_nothing(file: h5py.File) -> None:
    file["frames"] = h5py.SoftLink("/none/frames")


def round_and_round(file: h5py.File) -> None:
    file["one"], file["frames"] = h5py.SoftLink("/one/more"), h5py.SoftLink("/one")


def too_large(file: h5py.File) -> None:
    file.create_dataset("frames", (COUNT, 1 << 31, 1 << 31), "u1", chunks=(1, 64, 64))


def too_small(file: h5py.File) -> None:
    file["frames"] = np.zeros((COUNT, 0, 8), np.uint8)


def not_held(file: h5py.File) -> None:
    file.create_dataset("frames", (COUNT, 8192, 8192), "u1", chunks=(1, 8192, 8192))


@pytest.mark.parametrize(
    ("make", "says"),
    [(not_held, "'frames' claims pieces of 67108864 bytes"),
     (to_itself, "links lead nowhere"), (round_and_round, "links lead nowhere"), (to_nothing, "expected the datasets"),
     (too_large, "2147483648x2147483648 pixels"), (too_small, "8x0 pixels")],
)  # fmt: skip
def test_frames_that_are_not_there(tmp_path: Path, make: Callable[[h5py.File], None], says: str) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        make(file)
        file["times_s"] = TIMES
    assert says in refused(tmp_path / "a.h5")[1]


def a_link(file: h5py.File, name: str, shape: tuple[int, ...]) -> None:
    file[name] = h5py.ExternalLink("pipe", "/x")


def a_link_by_links(file: h5py.File, name: str, shape: tuple[int, ...]) -> None:
    file["group/out"] = h5py.ExternalLink("pipe", "/")
    file["group/inner"] = h5py.SoftLink("out/there")
    file[name] = h5py.SoftLink("/group/./inner")


def bytes_elsewhere(file: h5py.File, name: str, shape: tuple[int, ...]) -> None:
    file.create_dataset(name, shape, "u1", external=[("/dev/zero", 0, h5py.h5f.UNLIMITED)])


def put_together(file: h5py.File, name: str, shape: tuple[int, ...]) -> None:
    layout = h5py.VirtualLayout(shape, "u1", maxshape=(None, *shape[1:]))
    source = h5py.VirtualSource("pipe", "x", shape, "u1", maxshape=(None, *shape[1:]))
    everything = (slice(None, h5py.h5s.UNLIMITED), *[slice(None)] * (len(shape) - 1))
    layout[everything] = source[everything]
    file.create_virtual_dataset(name, layout)


@pytest.mark.parametrize("name", ["frames", "times_s"])
@pytest.mark.parametrize("make", [a_link, a_link_by_links, bytes_elsewhere, put_together])
def test_pictures_in_other_files_are_not_looked_for(
    tmp_path: Path, make: Callable[[h5py.File, str, tuple[int, ...]], None], name: str
) -> None:
    """The other file is a pipe without a writer, so that opening it would block forever."""
    os.mkfifo(tmp_path / "pipe")
    held: dict[str, Any] = {"frames": np.zeros((COUNT, 8, 8), np.uint8), "times_s": TIMES}
    with h5py.File(tmp_path / "a.h5", "w") as file:
        make(file, name, held[name].shape)
        other = "times_s" if name == "frames" else "frames"
        file[other] = held[other]
    assert "its pictures lie in other files: copy them into one" in refused(tmp_path / "a.h5")[1]


def test_links_within_a_film_are_followed(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["take/camera/pictures"] = np.full((COUNT, 8, 8), 3, np.uint8)
        file["take/frames"] = h5py.SoftLink("camera//pictures")
        file["frames"], file["times_s"] = h5py.SoftLink("/take/frames"), TIMES
    with open_film(tmp_path / "a.h5") as film:
        assert [frame.pixels.mean() for frame in film] == [3] * COUNT


@pytest.mark.parametrize(("frames", "refuses"), [(4, False), (5, True), (60, True)])
def test_packed_pieces_too_large_to_hold(tmp_path: Path, frames: int, refuses: bool) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        shape = (frames, 8192, 8192)
        file.create_dataset("frames", shape, "u1", chunks=shape, compression="gzip")
        file["times_s"] = np.arange(frames) / 1000
    if refuses:
        assert (
            "more than 0.3 GB, which are unpacked as a whole: repack it with one frame a chunk"
            in refused(tmp_path / "a.h5")[1]
        )
    else:
        with open_film(tmp_path / "a.h5") as film:
            assert film.frame_count == frames


def test_times_in_pieces_larger_than_the_file(tmp_path: Path) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frames"] = np.zeros((COUNT, 8, 8), np.uint8)
        file.create_dataset("times_s", (COUNT,), "f8", chunks=(1 << 24,), maxshape=(None,))
    assert "'times_s' claims pieces of 134217728 bytes" in refused(tmp_path / "a.h5")[1]


@pytest.mark.parametrize("layout", [{}, {"chunks": True}, {"chunks": (2, 8, 8), "compression": "gzip"}], ids=str)
def test_films_of_other_layouts_are_read(tmp_path: Path, layout: dict[str, Any]) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("frames", data=np.full((COUNT, 8, 8), 3, np.uint8), **layout)
        file["times_s"] = TIMES
    with open_film(tmp_path / "a.h5") as film:
        assert [frame.pixels.mean() for frame in film] == [3] * COUNT


def test_a_record_of_values_that_no_film_has_is_none() -> None:
    good = FilmRecord(rate_hz=1000.0, bits=8, start_s=0.0, metadata={})
    assert FilmRecord.loads(good.dumps()) == good
    for wrong in (
        {"rate_hz": 0},
        {"rate_hz": 1e300},
        {"rate_hz": "NaN"},
        {"bits": 99},
        {"bits": 1e999},
        {"start_s": 1e300},
    ):
        text = FilmRecord(**{"rate_hz": 1000.0, "bits": 8, "start_s": 0.0, "metadata": {}, **wrong}).dumps()  # type: ignore[arg-type]
        assert FilmRecord.loads(text) is None


def test_a_pipe_is_no_film(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.mkv")
    assert "is a pipe or a device" in refused(tmp_path / "a.mkv")[1]
    assert "is a pipe or a device" in refused(Path("/dev/zero"))[1]


def test_a_film_of_other_bits_than_it_notes(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    with create_film(path, width=16, height=16, rate_hz=1000) as film:
        film.write(Frame(0, 0.0, np.zeros((16, 16), np.uint8)))
    held = path.read_bytes()
    assert b'"bits": 8' in held
    path.write_bytes(held.replace(b'"bits": 8,', b'"bits":12,'))
    assert "pictures of 8 bits, but notes 12" in refused(path)[1]


STEP = 6
"""Gray level increment per picture."""


def coded(path: Path, codec: str, options: dict[str, str]) -> Path:
    """Write a film with rising gray levels and B-frames, stamped in decoding order."""
    tick = Fraction(1, 1000)
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=1000, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 32, "yuv420p"
        stream.time_base = stream.codec_context.time_base = tick
        packets = []
        for k in range(40):
            planes = np.vstack([np.full((32, 64), STEP * k, np.uint8), np.full((16, 64), 128, np.uint8)])
            picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            picture.pts, picture.time_base = k, tick
            packets += stream.encode(picture)
        for k, packet in enumerate([*packets, *stream.encode()]):
            packet.pts = packet.dts = k
            container.mux(packet)
    return path


@pytest.mark.parametrize(
    ("codec", "options"),
    [("mpeg4", {"bf": "2"}), ("libx265", {"x265-params": "bframes=4:log-level=none"}), ("libx264", {"bf": "3"})],
)
@pytest.mark.parametrize("suffix", [".mkv", ".mp4", ".avi", ".nut"])
def test_stamps_in_the_order_of_coding_are_put_right(
    tmp_path: Path, codec: str, options: dict[str, str], suffix: str
) -> None:
    if codec not in av.codecs_available:
        pytest.skip(f"FFmpeg lacks {codec} here")
    if (codec, suffix) == ("libx265", ".avi"):
        pytest.skip("AVI does not hold H.265")
    with open_film(coded(tmp_path / f"a{suffix}", codec, options)) as film:
        frames = list(film)
    assert np.diff([frame.time_s for frame in frames]) == pytest.approx(1e-3)
    levels = [int(frame.pixels.mean()) for frame in frames]
    assert len(levels) == 40
    assert levels == sorted(levels)
