"""The pages show unexpected server exceptions as a line of text, in a real browser."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("playwright", reason="playwright is not installed: pip install playwright")

import uvicorn
from browsers import browser, needs_chromium, quiet_page
from playwright.sync_api import Page, expect

from heliograph.base.frames import Frame
from heliograph.media import create_film
from heliograph.web.app import create_app
from heliograph.web.limits import Limits
from heliograph.web.serve import Address, open_port, server_config

pytestmark = [pytest.mark.slow, needs_chromium]

LINE = "The server failed by an internal error (ValueError: broken)"


def broken(*_values: Any, **_named: Any) -> Any:
    raise ValueError("broken")


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("films") / "dark.h5"
    with create_film(path, width=64, height=48, rate_hz=1000) as out:
        for k in range(40):
            out.write(Frame(k, k / 1000, np.zeros((48, 64), np.uint8)))
    return path


@pytest.fixture
def address(film: Path) -> Iterator[str]:
    """Serve the pages from a thread in this process, so that tests can inject faults."""
    place, limits = Address(port=0), Limits()
    server = uvicorn.Server(server_config(create_app(films=[str(film)], limits=limits), place, limits))
    with open_port(place) as waiting:
        thread = threading.Thread(target=server.run, kwargs={"sockets": [waiting]})
        thread.start()
        try:
            while not server.started:
                time.sleep(0.01)
            yield f"http://127.0.0.1:{waiting.getsockname()[1]}/"
        finally:
            server.should_exit = True
            thread.join()


def expect_notice(page: Page) -> None:
    notice = page.locator(".notice[role=alert]")
    expect(notice).to_contain_text(LINE)
    expect(notice).to_be_visible()


def test_page_watch_shows_a_crash_of_its_reception(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.watching.run.receive_film", broken)
    with browser() as found, quiet_page(found, f"{address}watch") as page:
        page.wait_for_selector("#named option", state="attached")
        page.click("#open")
        expect_notice(page)
        for button in ("stop", "pause", "step", "packet", "save"):
            expect(page.locator(f"#{button}")).to_be_disabled()
        expect_notice(page)  # the end of the connection keeps the notice


def test_page_receive_shows_a_crash_of_its_reception(address: str, film: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.receive.PageReader.read_upload", broken)
    with browser() as found, quiet_page(found, f"{address}receive") as page:
        page.set_input_files("#film", film)
        expect_notice(page)
        expect(page.locator("#state")).to_have_text("Ended.")
        expect(page.locator("#stop")).to_be_hidden()


def test_page_transmit_shows_a_crash_of_its_coding(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.transmit.sending_of", broken)
    with browser() as found:
        page = found.new_page()
        page.goto(f"{address}transmit")
        page.wait_for_selector("#rate option", state="attached")
        page.fill("#text", "hello")
        page.click("#send")
        expect_notice(page)
