"""The pages show unexpected server exceptions as a line of text, in a real browser."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("playwright", reason="playwright is not installed: pip install playwright")

from browsers import needs_chromium, quiet_page
from playwright.sync_api import Browser, Page, expect
from web_server import serving

pytestmark = [pytest.mark.slow, needs_chromium]


def broken(*_values: Any, **_named: Any) -> Any:
    raise ValueError("broken")


@pytest.fixture(scope="module")
def address(dark_film: Path) -> Iterator[str]:
    with serving([dark_film]) as url:
        yield url


def expect_notice(page: Page) -> None:
    notice = page.locator(".notice[role=alert]")
    expect(notice).to_contain_text("The server failed by an internal error (ValueError: broken)")
    expect(notice).to_be_visible()


def test_page_watch_shows_a_crash_of_its_reception(
    chromium: Browser, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heliograph.web.watching.run.receive_and_count", broken)
    with quiet_page(chromium, f"{address}watch") as page:
        page.wait_for_selector("#named option", state="attached")
        page.click("#open")
        expect_notice(page)
        for button in ("stop", "pause", "step", "packet", "save"):
            expect(page.locator(f"#{button}")).to_be_disabled()
        expect_notice(page)  # the end of the connection keeps the notice


def test_page_receive_shows_a_crash_of_its_reception(
    chromium: Browser, address: str, dark_film: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heliograph.web.receive.PageReader.read_upload", broken)
    with quiet_page(chromium, f"{address}receive") as page:
        page.set_input_files("#film", dark_film)
        expect_notice(page)
        expect(page.locator("#state")).to_have_text("Ended.")
        expect(page.locator("#stop")).to_be_hidden()


def test_page_transmit_shows_a_crash_of_its_coding(
    chromium: Browser, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heliograph.web.transmit.sending_of", broken)
    page = chromium.new_page()
    page.goto(f"{address}transmit")
    page.wait_for_selector("#rate option", state="attached")
    page.fill("#text", "hello")
    page.click("#send")
    expect_notice(page)
    page.close()
