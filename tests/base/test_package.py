"""Package structure: import time and public names."""

import subprocess
import sys

import pytest
from waiting import HANG_S

import heliograph

HEAVY = ("numba", "matplotlib", "cv2", "scipy", "h5py", "av", "numpy", "pydantic")


def run(code: str) -> str:
    command = [sys.executable, "-c", code]
    out = subprocess.run(command, capture_output=True, text=True, timeout=HANG_S, check=False)
    assert out.returncode == 0, out.stderr.splitlines()[-1]
    return out.stdout.strip()


@pytest.mark.slow
def test_package_and_command_import_no_heavy_library() -> None:
    code = f"print([m for m in {HEAVY} if m in sys.modules])"
    imports = f"import sys, heliograph; {code}\nimport heliograph.cli.main; {code}"
    assert run(f"{imports}\nimport heliograph.signal.turbo; print('numba' in sys.modules)") == "[]\n[]\nFalse"


@pytest.mark.slow
def test_public_names_stay_the_same_and_need_no_extra() -> None:
    """A function named like a subpackage (sweep) must not become the subpackage after import."""
    code = """import sys; sys.modules['xarray'] = None; import heliograph as h
for n in h.__all__: assert getattr(h, n) is getattr(h, n) and callable(getattr(h, n)) and getattr(h, n).__doc__, n
try: h.sweep({})
except h.HeliographError as error: print(error)"""
    assert run(code) == "a Dataset needs xarray: pip install 'heliograph[analysis]'"


def test_package_has_a_version_and_no_other_names() -> None:
    assert heliograph.__version__
    with pytest.raises(AttributeError, match="nonsense"):
        _ = heliograph.nonsense
