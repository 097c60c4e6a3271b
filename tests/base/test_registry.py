"""Parts by name, and how another process gets those of one's own."""

import subprocess
import sys
from pathlib import Path

import pytest

from heliograph.base.errors import SettingsError
from heliograph.base.registry import Registry, digest, load_parts, registered

COLOURS: Registry[str] = Registry("colour", "test.colours", {"red": "string:digits"})


def test_a_part_of_the_package_is_imported_when_asked_for() -> None:
    assert COLOURS["red"] == "0123456789"
    assert COLOURS.is_built_in("red")


def test_a_registered_part_is_found_and_can_be_replaced() -> None:
    COLOURS.register("blue", "first")
    COLOURS.register("blue", "second")
    assert COLOURS["blue"] == "second"
    assert COLOURS.names() == ["red", "blue"]
    assert not COLOURS.is_built_in("blue")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("red", "is one of the package"),
        ("", "name has letters"),
        ("a b", "name has letters"),
        ("é/", "name has letters"),
    ],
)
def test_names_that_are_refused(name: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        COLOURS.register(name, "x")


def test_an_unknown_name_is_an_error_that_names_the_nearest() -> None:
    with pytest.raises(SettingsError, match="unknown colour 'rad'; did you mean 'red'"):
        COLOURS.check("rad")
    with pytest.raises(SettingsError, match="unknown colour 'zzzz'; there are red"):
        COLOURS.check("zzzz")


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "No such file"), (b"\xff", "can't decode"), (b"1 /", "SyntaxError"), (b"1 / 0", "ZeroDivisionError")],
)
def test_a_file_of_parts_that_cannot_be_run_is_one_line(tmp_path: Path, content: bytes | None, message: str) -> None:
    file = tmp_path / "broken_parts.py"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(SettingsError, match=message) as caught:
        load_parts(file)
    assert str(file) in str(caught.value)
    assert "loaded_broken_parts" not in sys.modules


PARTS = """
import heliograph
from beside import Nothing

heliograph.register_receiver("nothing", Nothing)
"""

BESIDE = """
class Nothing:
    detections = 0

    def __init__(self, signal, settings, observe):
        pass

    def push(self, frame):
        yield from ()

    finish = push
"""

PROGRAM = """
import pickle, sys
from heliograph import load_parts
from heliograph.base.registry import registered
load_parts("parts.py")
sys.stdout.buffer.write(pickle.dumps(registered()))
"""

WORKER = """
import pickle, sys
from heliograph.base.registry import register_again
register_again(pickle.load(sys.stdin.buffer))
import heliograph
receiver = heliograph.make_receiver(heliograph.SignalSettings(), heliograph.ReceiveSettings(receiver=sys.argv[1]))
print(type(receiver).__name__)
"""


def run(program: str, *arguments: str, folder: Path, given: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    command = [sys.executable, "-c", program, *arguments]
    return subprocess.run(command, cwd=folder, input=given, capture_output=True, timeout=120)


@pytest.mark.slow
def test_another_process_runs_the_file_again_even_where_it_does_not_lie(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text(BESIDE)
    (tmp_path / "parts.py").write_text(PARTS)
    parts = run(PROGRAM, folder=tmp_path).stdout
    (tmp_path / "parts.py").unlink()
    assert run(WORKER, "nothing", folder=tmp_path, given=parts).stdout == b"Nothing\n"


@pytest.mark.slow
def test_what_does_not_come_by_running_a_file_again_is_an_error_once_it_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text(BESIDE)
    (tmp_path / "parts.py").write_text(PARTS)
    parts = run(PROGRAM, folder=tmp_path).stdout
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert run(WORKER, "nothing", folder=elsewhere, given=parts).stdout == b"Nothing\n"
    (tmp_path / "beside.py").unlink()
    assert run(WORKER, "plain", folder=elsewhere, given=parts).stdout == b"StreamReceiver\n"
    wrong = run(WORKER, "nothing", folder=elsewhere, given=parts)
    assert b"'nothing' is not registered in this worker process" in wrong.stderr
    assert b"No module named 'beside'" in wrong.stderr


@pytest.mark.slow
def test_what_is_registered_by_hand_cannot_go_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "beside.py").write_text(BESIDE)
    program = PROGRAM.replace('load_parts("parts.py")', PARTS)
    wrong = run(WORKER, "nothing", folder=tmp_path, given=run(program, folder=tmp_path).stdout)
    assert b"write it into a file" in wrong.stderr


def test_files_of_one_name_are_different_modules(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "parts.py").write_text(
            f"import heliograph\nheliograph.register_receiver('own-{name}', lambda *_: None)\n"
        )
        load_parts(tmp_path / name / "parts.py")
    files = {part.module.file for part in registered() if part.module and part.name in ("own-one", "own-two")}
    assert files == {str(tmp_path / name / "parts.py") for name in ("one", "two")}


def test_the_digest_follows_the_text_of_loaded_files(tmp_path: Path) -> None:
    file, found = tmp_path / "changing.py", list[str]()
    for text in ("x = 1", "x = 1", "x = 2"):
        file.write_text(f"import heliograph\n{text}\nheliograph.register_receiver('changing', lambda *_: None)\n")
        load_parts(file)
        found.append(digest())
    assert found[0] == found[1] != found[2]
