"""Package structure: import time, module docstrings and public names."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import HANG_S

import heliograph

ROOT = Path(heliograph.__file__).parent
MODULES = sorted(ROOT.rglob("*.py"))
HEAVY = ("numba", "matplotlib", "cv2", "scipy", "h5py", "av", "numpy", "pydantic")


def test_importing_the_package_costs_nothing() -> None:
    code = f"import sys, heliograph; print([m for m in {HEAVY} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=HANG_S)
    assert out.stdout.strip() == "[]"


def test_the_command_without_work_loads_nothing_heavy() -> None:
    code = f"import sys, heliograph.cli.main; print([m for m in {HEAVY} if m in sys.modules])"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=HANG_S)
    assert out.stdout.strip() == "[]"


@pytest.mark.parametrize("path", MODULES, ids=lambda path: str(path.relative_to(ROOT)))
def test_every_module_has_a_docstring(path: Path) -> None:
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    assert text is not None
    assert len(text.split()) > 1, f"'{text}' says nothing"


def test_public_names_are_there_and_described() -> None:
    assert heliograph.__version__
    for name in heliograph.__all__:
        assert getattr(heliograph, name).__doc__, name


@pytest.mark.slow
def test_public_names_mean_the_same_the_second_time() -> None:
    """A function named like a subpackage (receive) must not become the subpackage after import."""
    names = ", ".join(f"'{name}'" for name in heliograph.__all__)
    code = f"import heliograph as h\nfor n in [{names}]:\n    assert getattr(h, n) is getattr(h, n), n\n"
    code += "    assert callable(getattr(h, n)), n"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=HANG_S, check=False)
    assert out.returncode == 0, out.stderr.splitlines()[-1]


@pytest.mark.slow
def test_sweep_is_there_without_the_extra() -> None:
    code = "import sys; sys.modules['xarray'] = None\nimport heliograph as h\n"
    code += "try: h.sweep({})\nexcept h.HeliographError as error: print(error)"
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=HANG_S)
    assert out.stdout.strip() == "a Dataset needs xarray: pip install xarray pandas h5netcdf"


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nonsense"):
        _ = heliograph.nonsense
