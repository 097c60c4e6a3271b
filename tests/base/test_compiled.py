"""Machine code cache: source changes invalidate entries; damaged or unwritable files are tolerated."""

import gc
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import heliograph
from heliograph.base.compiled import KEPT_FOLDERS, compiled

ROOT = Path(heliograph.__file__).parent

LOOPS = """
from heliograph.base.compiled import compiled
from heliograph.helper import FACTOR, plus

@compiled()
def total(x):
    return FACTOR * plus(x)
"""
HELPER = """
from heliograph.base.compiled import compiled
FACTOR = {factor}

@compiled()
def plus(x):
    return x + {term}
"""
SERVER = """
import io, json, os, sys
import numba
from numba.core import config, event

class Terminal(io.StringIO):
    def isatty(self):
        return True

known = dict(os.environ)
for line in sys.stdin:
    package, is_terminal, changes = json.loads(line)
    os.environ.clear()
    os.environ.update(known | changes)
    config.reload_config()
    sys.path[0] = package
    for name in [name for name in sys.modules if name.partition(".")[0] == "heliograph"]:
        del sys.modules[name]
    sys.stderr, listeners = Terminal() if is_terminal else io.StringIO(), event._registered["numba:compile"]
    before = list(listeners)
    import heliograph.loops as loops
    values, stats = [loops.total(2.0), loops.total(2)], loops.total.stats
    for listener in set(listeners) - set(before):
        event.unregister("numba:compile", listener)
    row = values[0], len(stats.cache_hits), bool(stats.cache_path), sys.stderr.getvalue()
    print(json.dumps(row), flush=True)
"""
"""Process that imports the package of a request with new modules, as a new process does, but loads Numba once."""

Call = Callable[..., list[object]]


@pytest.fixture(scope="module")
def server() -> Iterator["subprocess.Popen[str]"]:
    environment = {key: value for key, value in os.environ.items() if key not in ("NUMBA_CACHE_DIR", "PYTHONPATH")}
    environment["PYTHONDONTWRITEBYTECODE"] = "1"
    with subprocess.Popen(
        [sys.executable, "-c", SERVER], env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        yield process
        process.kill()


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Create a stand-in package with two kernel modules."""
    folder = tmp_path / "heliograph"
    (folder / "base").mkdir(parents=True)
    for name in ("__init__.py", "base/__init__.py"):
        (folder / name).touch()
    shutil.copy(ROOT / "base/compiled.py", folder / "base")
    (folder / "loops.py").write_text(LOOPS)
    write_helper(folder, 3, 1)
    return folder


@pytest.fixture
def call(server: "subprocess.Popen[str]", package: Path) -> Call:
    """Call the kernel; return the sum, the number of cache hits, whether a cache exists, and the standard error."""

    def run(is_terminal: bool = False, **changes: str) -> list[object]:
        assert server.stdin is not None
        assert server.stdout is not None
        changes = {"XDG_CACHE_HOME": str(package.parent / "cache"), **changes}
        server.stdin.write(json.dumps([str(package.parent), is_terminal, changes]) + "\n")
        server.stdin.flush()
        row: list[object] = json.loads(server.stdout.readline())
        assert is_terminal or row[3] == "", "quiet in a pipe"
        return row if is_terminal else row[:3]

    return run


def write_helper(folder: Path, factor: int, term: int) -> None:
    """Write the second module with a fixed modification time, as a wheel does."""
    (folder / "helper.py").write_text(HELPER.format(factor=factor, term=term))
    os.utime(folder / "helper.py", (1_600_000_000, 1_600_000_000))


@pytest.mark.slow
def test_a_change_in_another_file_compiles_again(package: Path, call: Call) -> None:
    """Change a function and a constant, but keep file date and size."""
    assert call() == [9.0, 0, True]
    write_helper(package, 3, 2)
    assert call() == [12.0, 0, True]
    write_helper(package, 4, 2)
    assert call() == [16.0, 0, True]
    write_helper(package, 3, 1)
    assert call() == [9.0, 2, True], "the first is still cached"


@pytest.mark.slow
def test_an_unwritable_folder_only_costs_time(call: Call) -> None:
    nowhere = "/dev/null/kernels"
    assert call(NUMBA_CACHE_DIR=nowhere) == [9.0, 0, False]
    assert call(HOME=nowhere, XDG_CACHE_HOME=nowhere) == [9.0, 0, False]


@pytest.mark.slow
def test_numba_cache_dir_is_used_and_old_folders_are_removed(call: Call, tmp_path: Path) -> None:
    """The most recent folders remain; a damaged file is rewritten."""
    cache = tmp_path / "own"
    for number in range(KEPT_FOLDERS + 3):
        (cache / f"heliograph-{number}").mkdir(parents=True)
        os.utime(cache / f"heliograph-{number}", (number, number))
    assert call(NUMBA_CACHE_DIR=str(cache)) == [9.0, 0, True]
    assert not (tmp_path / "cache").exists()
    assert len(list(cache.glob("heliograph-*"))) == KEPT_FOLDERS
    for ending in ("nbc", "nbi"):
        for path in cache.glob(f"*/*/loops.total*.{ending}"):
            path.write_bytes(path.read_bytes()[:100])
        assert call(NUMBA_CACHE_DIR=str(cache)) == [9.0, 0, True]
    assert call(NUMBA_CACHE_DIR=str(cache)) == [9.0, 2, True]


@pytest.mark.slow
def test_a_terminal_shows_once_that_it_compiles(call: Call) -> None:
    first, second = (str(call(is_terminal=True)[3]) for _ in range(2))
    assert first.count("\n") == 1
    assert first.startswith("compiling for this computer")
    assert second == ""


@pytest.mark.slow
def test_garbage_collection_resumes_after_compiling() -> None:
    @compiled()
    def double(x: float) -> float:
        return x + x

    assert gc.isenabled()
    assert (double(1.5), gc.isenabled()) == (3.0, True)
    gc.disable()
    assert (double(2), gc.isenabled()) == (4, False), "as it was"
    gc.enable()


def test_only_this_decorator_compiles() -> None:
    others = [path for path in ROOT.rglob("*.py") if "njit" in path.read_text() and path.name != "compiled.py"]
    assert others == []
