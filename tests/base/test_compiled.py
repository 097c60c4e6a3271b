"""Machine code that is kept: renewed when any part of it changes, and not missed where it cannot be kept."""

import ast
import gc
import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from waiting import HANG_S

import heliograph
from heliograph.base import compile_time
from heliograph.base.compiled import KEPT, sources

ROOT = Path(heliograph.__file__).parent
KERNELS = sorted(
    ".".join(("heliograph", *path.relative_to(ROOT).with_suffix("").parts))
    for path in ROOT.rglob("*.py")
    if "import compiled\n" in path.read_text() and path.stem != "compiled"
)

LOOPS = """
from heliograph.base.compiled import compiled
from small.helper import FACTOR, plus

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
CALL = "import small.loops as m; r = m.total(2.0); s = m.total.stats; print(r, len(s.cache_hits), bool(s.cache_path))"


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """A package of two modules with kernels."""
    folder = tmp_path / "small"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "loops.py").write_text(LOOPS)
    write_helper(folder, 3, 1)
    return folder


def write_helper(folder: Path, factor: int, term: int) -> None:
    """A wheel's files have one date, so these have."""
    (folder / "helper.py").write_text(HELPER.format(factor=factor, term=term))
    os.utime(folder / "helper.py", (1_600_000_000, 1_600_000_000))


def called(small: Path, cache: str | None = None, code: str = CALL, **environment: str) -> list[str]:
    """What a new process prints: the sum, machine code found, whether there is a folder for it."""
    known = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    known |= {"PYTHONPATH": os.pathsep.join([str(small.parent), str(ROOT.parent)]), "PYTHONDONTWRITEBYTECODE": "1"}
    known |= {"NUMBA_CACHE_DIR": cache} if cache else {}
    command = [sys.executable, "-c", code]
    done = subprocess.run(
        command, env=known | environment, capture_output=True, text=True, timeout=HANG_S, check=False, cwd=small.parent
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr == "", "quiet in a pipe"
    return done.stdout.split()


@pytest.mark.slow
def test_what_another_file_has_is_compiled_anew(small: Path) -> None:
    """A function and a constant; the file's date and size stay as they were."""
    assert called(small) == ["9.0", "0", "True"]
    assert called(small) == ["9.0", "1", "True"]
    write_helper(small, 3, 2)
    assert called(small) == ["12.0", "0", "True"]
    write_helper(small, 4, 2)
    assert called(small) == ["16.0", "0", "True"]
    write_helper(small, 3, 1)
    assert called(small) == ["9.0", "1", "True"], "the first is still there"


@pytest.mark.slow
def test_a_folder_that_cannot_be_written_is_done_without(small: Path) -> None:
    """Below a file there is no folder, whoever asks."""
    nowhere = "/dev/null/kernels"
    assert called(small, nowhere) == ["9.0", "0", "False"]
    (small / "__pycache__").write_text("no folder")
    assert called(small, HOME=nowhere, XDG_CACHE_HOME=nowhere) == ["9.0", "0", "False"]


@pytest.mark.slow
def test_a_folder_of_the_users_choice_is_taken(small: Path, tmp_path: Path) -> None:
    """Others of the same module go, but for the latest used; a damaged file is written again."""
    cache = tmp_path / "own"
    for number in range(KEPT + 3):
        (cache / f"small.loops-{number}").mkdir(parents=True)
        os.utime(cache / f"small.loops-{number}", (number, number))
    assert called(small, str(cache)) == ["9.0", "0", "True"]
    assert not (small / "__pycache__").exists()
    assert len(list(cache.glob("small.loops-*"))) == KEPT
    (kept,) = cache.glob("small.loops-*/*.nbc")
    kept.write_bytes(kept.read_bytes()[:100])
    assert called(small, str(cache)) == ["9.0", "0", "True"]
    assert called(small, str(cache)) == ["9.0", "1", "True"]


@pytest.mark.slow
def test_on_a_terminal_compiling_is_told_once_and_not_counted(small: Path) -> None:
    code = "import time, small.loops as m; from heliograph.base.compile_time import clock; m.total(2.0)\n"
    code += "a, b = time.monotonic(), clock(); m.total(2)\n"
    code += "c, d = time.monotonic() - a, clock() - b; assert 0 <= d < c, (c, d)"
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": os.pathsep.join([str(small.parent), str(ROOT.parent)])}
    said: list[str] = []
    for _ in range(2):
        ours, theirs = pty.openpty()
        subprocess.run([sys.executable, "-c", code.split("c, d")[0] if said else code], env=environment, stderr=theirs,
                       timeout=HANG_S, check=True)  # fmt: skip
        os.close(theirs)
        try:
            said.append(os.read(ours, 10_000).decode())
        except OSError:  # nothing was said
            said.append("")
        os.close(ours)
    assert said[0].count("\n") == 1
    assert said[0].startswith("compiling for this computer")
    assert said[1] == ""


@pytest.mark.slow
def test_what_other_kernels_alone_call_refuses_python_and_is_kept_with_them(small: Path) -> None:
    """Such a function has no way in from Python; without the refusal the process would end."""
    loops = (
        (small / "loops.py")
        .read_text()
        .replace("total(x)", "total(x):\n    return _inner(x)\n\n@compiled()\ndef _inner(x)")
    )
    (small / "loops.py").write_text(loops)
    code = CALL + "\ntry: m._inner(2.0)\nexcept TypeError as error: print('compiled functions alone' in str(error))"
    assert called(small, code=code) == ["9.0", "0", "True", "True"]
    assert called(small, code=code) == ["9.0", "1", "True", "True"]


def test_garbage_is_collected_again_once_it_is_compiled() -> None:
    from heliograph.receive.geometry.kernels import median

    assert gc.isenabled()
    assert median(np.array([3.0, 1.0, 2.0])) == 2.0
    assert gc.isenabled()
    gc.disable()
    median(np.array([3.0, 1.0], dtype=np.float32))
    assert not gc.isenabled(), "as it was"
    gc.enable()


def test_the_clock_stands_still_while_it_compiles() -> None:
    compile_time.begin()
    compile_time.begin()
    first = compile_time.clock()
    compile_time.end()
    assert compile_time.clock() == first
    compile_time.end()
    assert first <= compile_time.clock() < first + 1


def imported(module: str) -> set[str]:
    """Modules of the package that a module imports, by its syntax tree."""
    path = ROOT.parent.joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    names = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            names |= {one.name for one in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert not node.level
            names |= {str(node.module), *(f"{node.module}.{one.name}" for one in node.names)}
    here = {name for name in names if name.partition(".")[0] == "heliograph"}
    return {
        name
        for name in here
        if (at := ROOT.parent.joinpath(*name.split("."))).is_dir() or at.with_suffix(".py").exists()
    }


@pytest.mark.parametrize("module", KERNELS)
def test_all_that_a_kernel_imports_is_in_its_digest(module: str) -> None:
    found, todo = set[str](), {module}
    while todo:
        name = todo.pop()
        found.add(name)
        todo |= imported(name) - found
    assert set(sources(module) or ()) == found


def test_every_kernel_is_kept_this_way() -> None:
    assert len(KERNELS) == 26
    others = [path for path in ROOT.rglob("*.py") if "njit" in path.read_text() and path.name != "compiled.py"]
    assert others == []
