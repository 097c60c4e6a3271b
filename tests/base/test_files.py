"""Atomic file creation, and printable names."""

import errno
import os
import pickle
from contextlib import nullcontext
from pathlib import Path

import pytest

from heliograph.base.errors import HeliographError, MediaError, printable
from heliograph.base.files import clear_write_errors, whole_file, write_whole


@pytest.mark.parametrize("error", [None, ValueError("x"), KeyboardInterrupt(), MediaError("said already")])
def test_a_file_takes_its_place_unless_something_goes_wrong(tmp_path: Path, error: BaseException | None) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(type(error)) if error else nullcontext(), whole_file(target) as partial:
        partial.write_text("new")
        assert target.read_text() == "old"
        if error:
            raise error
    assert (target.read_text(), list(tmp_path.iterdir())) == ("old" if error else "new", [target])


def test_a_place_that_cannot_be_written_is_reported(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "none" / "a", tmp_path / "file" / "a", tmp_path):
        with pytest.raises(MediaError, match=r"cannot write .*y; choose another place"):
            write_whole(target, b"x")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
    assert not list(tmp_path.parent.glob(".*partial"))


@pytest.mark.parametrize(("number", "cure"), [
    (errno.ENOSPC, "No space left on device; make room or choose another place"),
    (errno.EDQUOT, ".*; make room or choose another place"),
    (errno.EFBIG, "File too large; make room or choose another place"),
    (errno.EACCES, "Permission denied; ask for the right to write there, or choose another place"),
    (errno.EROFS, "Read-only file system; choose another place"),
])  # fmt: skip
def test_the_cure_is_that_of_the_error(number: int, cure: str) -> None:
    with pytest.raises(MediaError, match=f"^cannot write a: {cure}$"), clear_write_errors(Path("a")):
        raise OSError(number, os.strerror(number))


@pytest.mark.parametrize("name", ["n" * 255, "試" * 85, "\udce9" * 255, "a\n"])
def test_a_name_of_any_length_that_the_file_system_allows_is_written(tmp_path: Path, name: str) -> None:
    write_whole(tmp_path / name, b"x")
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_name_that_is_too_long_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    reason = r"cannot write .*/n{256}: File name too long; choose a name of at most 255 bytes"
    with pytest.raises(MediaError, match=reason), whole_file(tmp_path / ("n" * 256)):
        pytest.fail("begun")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("text", "shown"), [
    ("drive 2.h5", "drive 2.h5"), ("試験-سلام-\N{GRINNING FACE}", "試験-سلام-\N{GRINNING FACE}"),
    ("می\u200cخواهم \N{WOMAN}\u200d\N{MICROSCOPE}\u3000", "می\u200cخواهم \N{WOMAN}\u200d\N{MICROSCOPE}\u3000"),
    ("caf\udce9.h5", r"caf\xe9.h5"), ("a\nb\tc\rd", r"a\nb\tc\rd"), ("\x1b[31mred\x7f", r"\x1b[31mred\x7f"),
    ("a\u2028b\u0085c", r"a\u2028b\x85c"), ("\u202egpj.exe", r"\u202egpj.exe"), ("\ud800", r"\ud800"),
    (r"C:\new\table", r"C:\new\table"),
])  # fmt: skip
def test_unprintable_characters_are_escaped(text: str, shown: str) -> None:
    assert (printable(text), printable(shown)) == (shown, shown)
    shown.encode()


@pytest.mark.parametrize("kind", [HeliographError, MediaError])
def test_a_message_is_one_line_whatever_it_names(kind: type[HeliographError]) -> None:
    error = kind("cannot read caf\udce9\n\x1b[2J.h5")
    assert (str(error), str(pickle.loads(pickle.dumps(error)))) == (r"cannot read caf\xe9\n\x1b[2J.h5", str(error))
