"""Machine code cache: source changes invalidate entries; damaged or unwritable files are tolerated."""

import gc
import os
import pty
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from waiting import HANG_S

import heliograph
from heliograph.base.compiled import KEPT_FOLDERS

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
CALL = (
    "import heliograph.loops as m; r = m.total(2.0); s = m.total.stats; print(r, len(s.cache_hits), bool(s.cache_path))"
)


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


def write_helper(folder: Path, factor: int, term: int) -> None:
    """Write the second module with a fixed modification time, as a wheel does."""
    (folder / "helper.py").write_text(HELPER.format(factor=factor, term=term))
    os.utime(folder / "helper.py", (1_600_000_000, 1_600_000_000))


def environment(package: Path, **changes: str) -> dict[str, str]:
    known = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    paths = {"PYTHONPATH": str(package.parent), "XDG_CACHE_HOME": str(package.parent / "cache")}
    return known | {"PYTHONDONTWRITEBYTECODE": "1"} | paths | changes


def call(package: Path, **changes: str) -> list[str]:
    """Run a new process and return the sum, the number of cache hits, and whether a cache exists."""
    command = [sys.executable, "-P", "-c", CALL]
    done = subprocess.run(
        command, env=environment(package, **changes), capture_output=True, text=True, timeout=HANG_S, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == "", "quiet in a pipe"
    return done.stdout.split()


@pytest.mark.slow
def test_a_change_in_another_file_compiles_again(package: Path) -> None:
    """Change a function and a constant, but keep file date and size."""
    assert call(package) == ["9.0", "0", "True"]
    write_helper(package, 3, 2)
    assert call(package) == ["12.0", "0", "True"]
    write_helper(package, 4, 2)
    assert call(package) == ["16.0", "0", "True"]
    write_helper(package, 3, 1)
    assert call(package) == ["9.0", "1", "True"], "the first is still cached"


@pytest.mark.slow
def test_an_unwritable_folder_only_costs_time(package: Path) -> None:
    nowhere = "/dev/null/kernels"
    assert call(package, NUMBA_CACHE_DIR=nowhere) == ["9.0", "0", "False"]
    assert call(package, HOME=nowhere, XDG_CACHE_HOME=nowhere) == ["9.0", "0", "False"]


@pytest.mark.slow
def test_numba_cache_dir_is_used_and_old_folders_are_removed(package: Path, tmp_path: Path) -> None:
    """The most recent folders remain; a damaged file is rewritten."""
    cache = tmp_path / "own"
    for number in range(KEPT_FOLDERS + 3):
        (cache / f"heliograph-{number}").mkdir(parents=True)
        os.utime(cache / f"heliograph-{number}", (number, number))
    assert call(package, NUMBA_CACHE_DIR=str(cache)) == ["9.0", "0", "True"]
    assert not (tmp_path / "cache").exists()
    assert len(list(cache.glob("heliograph-*"))) == KEPT_FOLDERS
    for ending in ("nbc", "nbi"):
        for path in cache.glob(f"*/*/loops.total*.{ending}"):
            path.write_bytes(path.read_bytes()[:100])
        assert call(package, NUMBA_CACHE_DIR=str(cache)) == ["9.0", "0", "True"]
    assert call(package, NUMBA_CACHE_DIR=str(cache)) == ["9.0", "1", "True"]


@pytest.mark.slow
def test_a_terminal_shows_once_that_it_compiles(package: Path) -> None:
    shown: list[str] = []
    for _ in range(2):
        ours, theirs = pty.openpty()
        code = "import heliograph.loops as m; m.total(2.0); m.total(2)"
        subprocess.run(
            [sys.executable, "-P", "-c", code], env=environment(package), stderr=theirs, timeout=HANG_S, check=True
        )
        os.close(theirs)
        try:
            shown.append(os.read(ours, 10_000).decode())
        except OSError:  # no output
            shown.append("")
        os.close(ours)
    assert shown[0].count("\n") == 1
    assert shown[0].startswith("compiling for this computer")
    assert shown[1] == ""


def test_garbage_collection_resumes_after_compiling() -> None:
    from heliograph.receive.geometry.kernels import median

    assert gc.isenabled()
    assert median(np.array([3.0, 1.0, 2.0])) == 2.0
    assert gc.isenabled()
    gc.disable()
    median(np.array([3.0, 1.0], dtype=np.float32))
    assert not gc.isenabled(), "as it was"
    gc.enable()


def test_only_this_decorator_compiles() -> None:
    others = [path for path in ROOT.rglob("*.py") if "njit" in path.read_text() and path.name != "compiled.py"]
    assert others == []
