"""Fixtures of the pages: a test client, a film, and a browser per file."""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from fastapi.testclient import TestClient
from web_server import OWN, write_dark_film

from heliograph.web.app import create_app

if TYPE_CHECKING:
    from playwright.sync_api import Browser


@pytest.fixture
def quick_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the collection of garbage after each reception."""
    monkeypatch.setattr("heliograph.web.connection.release_memory", lambda: None)


@pytest.fixture(scope="module")
def dark_film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Film of 40 frames without an array."""
    return write_dark_film(tmp_path_factory.mktemp("films") / "dark.h5")


@pytest.fixture(scope="module")
def client() -> Iterator[TestClient]:
    """Client of a server without films."""
    with TestClient(create_app(), base_url=OWN, raise_server_exceptions=False) as made:
        yield made


@pytest.fixture(scope="module")
def chromium() -> "Iterator[Browser]":
    """Browser of a file; its event loop would block `asyncio.run` in other files."""
    from browsers import browser
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright, browser(playwright.chromium) as found:
        yield found
