import json
import multiprocessing
import subprocess
import sys
from pathlib import Path

import pytest

from heliograph.cli import first_use

# a reception after the compilation ahead; prints the names of its kernels that compile or load more versions
RECEPTION = """
import json, sys
from pathlib import Path
from numba.core.dispatcher import Dispatcher
from heliograph.cli import first_use, main

def versions():
    modules = [module for name, module in sys.modules.items() if name.startswith("heliograph.") and "kernels" in name]
    kernels = {name: value for module in modules for name, value in vars(module).items()}
    return {name: len(value.signatures) for name, value in kernels.items() if isinstance(value, Dispatcher)}

first_use.begin_worker = lambda: None
first_use.compile_kernels()
before = versions()
sys.argv = ["heliograph", "receive", sys.argv[1]]
main.app(standalone_mode=False)
changed = [name for name, count in versions().items() if before.get(name) and count != before[name]]
Path("changed.json").write_text(json.dumps([changed, sorted(name for name, count in before.items() if count)]))
"""


def test_a_reception_uses_the_kernels_compiled_ahead(tmp_path: Path) -> None:
    """Other types of an argument would compile a second version of the kernel."""
    film, heliograph = tmp_path / "film.mp4", [sys.executable, "-m", "heliograph"]
    subprocess.run(
        [*heliograph, "simulate", film, "--set", "channel.duration_s=0.12", "--set", "channel.weather.glare=0.3"],
        check=True,
    )
    subprocess.run([sys.executable, "-c", RECEPTION, film], check=True, cwd=tmp_path, stdout=subprocess.DEVNULL)
    changed, ahead = json.loads((tmp_path / "changed.json").read_text())
    assert not changed
    assert {"fit", "preview", "condition", "iterate", "mother_posterior", "footprints"} <= set(ahead)


def compilers() -> set[multiprocessing.process.BaseProcess]:
    return {process for process in multiprocessing.active_children() if process.name == "compiler"}


def test_kernels_are_compiled_ahead_unless_the_cache_has_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(first_use, "cache_folder", lambda: tmp_path)
    monkeypatch.setattr(first_use, "cores", lambda: 2)
    (tmp_path / "kernels.fit-1.py311.nbi").touch()
    before = compilers()  # of other tests
    first_use.compile_ahead()
    assert compilers() <= before
    (tmp_path / "kernels.fit-1.py311.nbi").unlink()
    (tmp_path / "kernels.warp-1.py311.nbi").touch()
    first_use.compile_ahead()
    (process,) = compilers() - before
    process.terminate()
    process.join()
