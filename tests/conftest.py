"""Shared by all tests: where the real recordings are."""

import os
from pathlib import Path

import pytest

SHARED_DATA = Path(os.environ.get("HELIOGRAPH_DATA", Path(__file__).parents[2] / "shared" / "data"))


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if SHARED_DATA.is_dir():
        return
    skip = pytest.mark.skip(reason=f"real recordings are absent (looked in {SHARED_DATA}; set HELIOGRAPH_DATA)")
    for item in items:
        if "real_data" in item.keywords:
            item.add_marker(skip)


@pytest.fixture(scope="session")
def data() -> Path:
    """Folder of the real recordings."""
    return SHARED_DATA
