"""Component registries, and registered components in worker processes."""

import importlib
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from heliograph.base import registry
from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.base.registry import Registry, _entries, digest, load_parts, register_again, registered
from heliograph.receive.api import make_receiver
from heliograph.receive.registry import RECEIVERS
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

COLOURS: Registry[str] = Registry("colour", "test.colours", {"red": "string:digits"})


def test_built_in_and_registered_parts_are_found() -> None:
    assert COLOURS["red"] == "0123456789"
    COLOURS.register("blue", "first", str)
    COLOURS.register("blue", "second", str)
    assert COLOURS["blue"] == "second"
    assert COLOURS.names() == ["red", "blue"]
    assert [name in COLOURS.built_in for name in COLOURS.names()] == [True, False]


def test_invalid_and_unknown_names_are_refused() -> None:
    for name, message in (
        ("red", "is one of the package"),
        *((name, "name has letters") for name in ("", "a b", "é/")),
    ):
        with pytest.raises(SettingsError, match=message):
            COLOURS.register(name, "x", str)
    for name, hint in (("rad", "did you mean 'red'"), ("zzzz", "there are red")):
        with pytest.raises(SettingsError, match=f"unknown colour '{name}'; {hint}"):
            COLOURS.check(name)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, "No such file"),
        (b"\xff", "SyntaxError: .*(can't decode|Non-UTF-8)"),  # the second since Python 3.14
        (b"1 /", "SyntaxError"),
        (b"1 / 0", "ZeroDivisionError"),
    ],
)
def test_a_file_of_parts_that_cannot_be_run_is_one_line(tmp_path: Path, content: bytes | None, message: str) -> None:
    file = tmp_path / "broken_parts.py"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(SettingsError, match=message) as caught:
        load_parts(file)
    assert str(file) in str(caught.value)
    assert "loaded_broken_parts" not in sys.modules


NOTHING = """
class Nothing:
    detections = 0

    def __init__(self, signal, settings, observe):
        pass

    def push(self, frame):
        yield from ()

    finish = push
"""


def forget(patch: pytest.MonkeyPatch) -> None:
    """Reset the registered parts, as in a new process."""
    patch.setattr(registry, "_files", {})
    patch.setattr(registry, "_failures", None)
    for parts in registry._registries.values():
        patch.setattr(parts, "_registered", {})
        patch.setattr(parts, "origins", {})
    patch.delitem(sys.modules, "neighbour", raising=False)
    register_again.cache_clear()


@pytest.fixture
def sources(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[str, ...]]:
    """Load a file that imports a neighbour, and return the sources for a new process, here without parts."""
    forget(monkeypatch)
    (tmp_path / "neighbour.py").write_text(NOTHING)
    code = "import heliograph\nfrom neighbour import Nothing\nheliograph.register_receiver('nothing', Nothing)\n"
    (tmp_path / "parts.py").write_text(code)
    monkeypatch.setattr(sys, "path", sys.path.copy())
    load_parts(tmp_path / "parts.py")
    sources = registered()
    forget(monkeypatch)
    yield sources
    register_again.cache_clear()
    importlib.invalidate_caches()


def make_nothing() -> str:
    return type(make_receiver(SignalSettings(), ReceiveSettings(receiver="nothing"))).__name__


def test_worker_runs_the_file_again(sources: tuple[str, ...]) -> None:
    register_again(sources)
    assert make_nothing() == "Nothing"


def test_failed_registration_in_a_worker_is_reported_with_the_first_use(
    sources: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "neighbour.py").unlink()
    shutil.rmtree(tmp_path / "__pycache__", ignore_errors=True)
    importlib.invalidate_caches()
    register_again(sources)
    assert RECEIVERS["plain"]
    message = "'nothing' is not registered in this worker process: .*No module named 'neighbour'"
    with pytest.raises(SettingsError, match=message):
        make_nothing()


@pytest.mark.usefixtures("sources")
def test_part_of_an_interactive_session_cannot_reach_a_worker(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "__main__", ModuleType("__main__"))
    maker: Any = lambda *_: None  # noqa: E731 - the attribute of a function is set
    maker.__module__ = "__main__"
    RECEIVERS.register("nothing", maker, maker)
    assert registered() == ()
    forget(monkeypatch)
    register_again(())
    with pytest.raises(SettingsError, match="write it into a file"):
        make_nothing()


def test_files_of_one_name_are_different_modules(tmp_path: Path) -> None:
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "parts.py").write_text(
            f"import heliograph\nheliograph.register_receiver('own-{name}', lambda *_: None)\n"
        )
        load_parts(tmp_path / name / "parts.py")
    assert {str(tmp_path / name / "parts.py") for name in ("one", "two")} <= set(registered())


def test_the_digest_follows_the_text_of_loaded_files(tmp_path: Path) -> None:
    file, found = tmp_path / "changing.py", list[str]()
    for text in ("x = 1", "x = 1", "x = 2"):
        file.write_text(f"import heliograph\n{text}\nheliograph.register_receiver('changing', lambda *_: None)\n")
        load_parts(file)
        found.append(digest())
    assert found[0] == found[1] != found[2]


OFFERED = """
from dataclasses import dataclass

from heliograph import own_settings
from heliograph.receive.registry import ReceiverPart

@dataclass(frozen=True)
class PatientSettings:
    patience: float = 0.5

class Offered:
    def __init__(self, signal, settings, observe):
        self.exposure_s, self.own = settings.calibration.exposure_s, own_settings(settings)

    def push(self, frame):
        yield from ()

    def finish(self):
        yield from ()

READER = ReceiverPart(Offered, reads=("calibration",))
PATIENT = ReceiverPart(Offered, PatientSettings, ("calibration",))
"""

ENTRY_POINTS = """
[heliograph.receivers]
offered = offered_parts:Offered
offered-reader = offered_parts:READER
offered-patient = offered_parts:PATIENT
offered-broken = offered_broken:Nothing
offered-gone = offered_parts:Gone
"""


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Install a stand-in package with receiver entry points, as pip would."""
    folder = tmp_path_factory.mktemp("installed")
    about = folder / "offered-1.5.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: offered\nVersion: 1.5\n")
    (about / "entry_points.txt").write_text(ENTRY_POINTS)
    (folder / "offered_parts.py").write_text(OFFERED)
    (folder / "offered_broken.py").write_text("1 / 0")
    before = digest()
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(folder)
        _entries.cache_clear()
        assert digest() != before
        yield
    sys.modules.pop("offered_parts", None)
    _entries.cache_clear()


def offered(name: str, **groups: Any) -> Any:
    settings = from_mapping(ReceiveSettings, {"receiver": f"offered{name}", **groups})
    return make_receiver(SignalSettings(), settings)


@pytest.mark.usefixtures("installed")
def test_installed_receivers_get_the_settings_that_they_declare() -> None:
    assert {"offered", "offered-reader"} <= {*RECEIVERS.names()}
    assert "offered" not in RECEIVERS.built_in
    assert type(offered("")).__name__ == "Offered"
    assert offered("").own is None
    calibration = {"exposure_s": 5e-4}
    assert offered("-reader", calibration=calibration).exposure_s == 5e-4
    for own, patience in (({}, 0.5), ({"patience": 2.0}, 2.0)):
        receiver = offered("-patient", custom=own, calibration=calibration)
        assert (receiver.own.patience, receiver.exposure_s) == (patience, 5e-4)


@pytest.mark.usefixtures("installed")
@pytest.mark.parametrize(
    ("name", "groups", "message"),
    [
        ("-broken", {}, "the receiver 'offered-broken' of offered_broken:Nothing cannot be loaded: division by zero"),
        ("-gone", {}, "the receiver 'offered-gone' of offered_parts:Gone cannot be loaded: .*'Gone'"),
        ("-reader", {"detect": {"score": 0.8}}, r"receive\.detect\.score has no effect"),
        ("", {"calibration": {"exposure_s": 5e-4}}, r"receive\.calibration\.exposure_s has no effect"),
        ("-patient", {"custom": {"patiense": 2.0}}, r"unknown .*patiense.*; did you mean 'patience'"),
        ("", {"custom": {"patience": 2.0}}, r"receive\.custom\.patience has no effect"),
    ],
)
def test_faults_of_installed_receivers_and_their_settings_are_one_line(
    name: str, groups: dict[str, Any], message: str
) -> None:
    with pytest.raises(SettingsError, match=message) as caught:
        offered(name, **groups)
    assert "\n" not in str(caught.value)
    # a broken entry point leaves built-in receivers usable
    assert RECEIVERS["plain"]
