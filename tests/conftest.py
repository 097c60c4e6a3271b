"""Shared by all tests: where the real recordings are, and logs that no test takes from the next."""

import logging
import os
from collections.abc import Iterator
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


@pytest.fixture(autouse=True)
def logs_are_kept() -> Iterator[None]:
    """Undo what a command that ran in this process did to logging: a sweep switches it off to its end."""
    yield
    logging.disable(logging.NOTSET)
