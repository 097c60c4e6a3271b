"""The pages are operated by keyboard only, in a real browser."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("playwright", reason="playwright is not installed: pip install playwright")

from browsers import browser, needs_chromium, quiet_page, webcam_of
from playwright.sync_api import Browser, Page, expect
from screen_films import Phone, phone_frames, write_webcam
from screen_light import shown
from web_server import serving

from heliograph.web.sending import sending_of

pytestmark = [pytest.mark.slow, needs_chromium]
PLACES = """
    () => {
      for (const place of document.querySelectorAll("[data-place]")) delete place.dataset.place;
      const before = document.createElement("span");
      before.tabIndex = -1;
      document.body.prepend(before);
      before.focus();
      return [...document.querySelectorAll("a[href], button, input, select, textarea, summary, [tabindex='0']")]
        .filter((place) => place.checkVisibility({ visibilityProperty: true }) && !place.matches(":disabled")
          && (place.type !== "radio" || place.checked))
        .map((place, k) => { place.dataset.place = k; return place.id || place.textContent.trim().slice(0, 30); });
    }
"""
"""Move the focus before all controls, and return their names; of radio buttons only the chosen one is a stop."""
FOCUS = """
    () => {
      const place = document.activeElement, style = getComputedStyle(place), box = place.getBoundingClientRect();
      const hasOutline = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2;
      const isInView = box.bottom > 0 && box.right > 0 && box.top < innerHeight && box.left < innerWidth;
      return [Number(place.dataset.place ?? -1), hasOutline && isInView, place.outerHTML.slice(0, 80)];
    }
"""
"""Number of the focused control, and True if its focus is visible."""
ON_TOP = """
    () => {
      const place = document.activeElement, box = place.getBoundingClientRect();
      const top = document.elementFromPoint((box.left + box.right) / 2, (box.top + box.bottom) / 2);
      const isFull = place === document.body || place === document.fullscreenElement;
      return [place.id, isFull || (place === top && Number(getComputedStyle(place.parentElement).opacity) === 1)];
    }
"""
"""Name of the focused control, and True if nothing covers it; in between, the focus is on the page."""
CLICK = """
    () => addEventListener("click", (event) => {
      event.target.dataset.clicked = !event.defaultPrevented;
      event.preventDefault();
    }, { once: true })
"""
"""Write on the element clicked next that the browser would act on the click, and keep the browser from it."""


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with serving() as url:
        yield url


def walk(page: Page) -> None:
    """Press Tab through a page to its end, and back."""
    names: list[str] = page.evaluate(PLACES)
    for number, name in enumerate(names):
        page.keyboard.press("Tab")
        found, is_visible, html = page.evaluate(FOCUS)
        assert found == number, f"{html} has the focus, not {name}"
        assert is_visible, f"the focus of {html} is not visible"
    for _ in names[1:]:
        page.keyboard.press("Shift+Tab")
    assert page.evaluate(FOCUS)[0] == 0


def tab_to(page: Page, name: str) -> None:
    """Press Tab until a control has the focus."""
    for _ in range(99):
        if page.evaluate("document.activeElement.id") == name:
            return
        page.keyboard.press("Tab")
    raise AssertionError(f"Tab does not reach {name}")


def test_first_page_by_keyboard(chromium: Browser, address: str) -> None:
    with quiet_page(chromium, address) as page:
        walk(page)
        page.keyboard.press("Enter")  # the link to the content
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        expect(page.locator("#tour")).to_be_visible()
        walk(page)
        page.get_by_role("button", name="Play").focus()
        page.keyboard.press("Space")
        expect(page.get_by_role("button", name="Pause")).to_be_focused()


def test_page_watch_by_keyboard(chromium: Browser, address: str) -> None:
    still: Any = {"reduced_motion": "reduce"}  # the drive waits for the user
    with quiet_page(chromium, f"{address}watch", **still) as page:
        page.wait_for_selector("#kind option", state="attached")
        walk(page)
        # so that the drive lasts until the second key
        page.select_option("#speed", "0.1")
        tab_to(page, "pause")
        page.keyboard.press("Space")
        page.wait_for_selector("#packets li", state="attached")
        page.keyboard.press("Space")
        expect(page.get_by_role("button", name="Resume")).to_be_focused()
        page.wait_for_timeout(1000)  # rows that are on the way
        walk(page)
        tab_to(page, "scrub")
        page.keyboard.press("Home")
        expect(page.locator("#where")).to_contain_text("(recorded)")
        page.locator("#details > summary").focus()
        page.keyboard.press("Enter")
        walk(page)


def test_page_transmit_by_keyboard(chromium: Browser, address: str) -> None:
    with quiet_page(chromium, f"{address}transmit") as page:
        page.wait_for_selector("#rate option", state="attached")
        walk(page)
        tab_to(page, "send")
        page.keyboard.press("Enter")
        for name in ("Cancel", "Send slowly", "Start"):
            expect(page.get_by_role("dialog").get_by_role("button", name=name)).to_be_focused()
            assert page.evaluate(FOCUS)[1]
            page.keyboard.press("Tab" if name != "Start" else "Enter")
        expect(page.locator("#pause")).to_be_enabled()
        expect(page.locator("#send")).to_be_focused()
        page.locator("details > summary").focus()
        page.keyboard.press("Enter")
        walk(page)
        tab_to(page, "pause")
        page.keyboard.press("Enter")
        expect(page.locator("#pause")).to_have_text("Resume")
        page.keyboard.press("Escape")
        expect(page.locator("#pause")).to_be_disabled()
        walk(page)


def test_full_screen_by_keyboard(chromium: Browser, address: str) -> None:
    with quiet_page(chromium, f"{address}transmit") as page:
        page.wait_for_selector("#rate option", state="attached")
        tab_to(page, "text")
        page.keyboard.type("Write, ")
        tab_to(page, "send")
        page.keyboard.press("Enter")
        for name in ("Cancel", "Send slowly", "Start"):
            expect(page.get_by_role("dialog").get_by_role("button", name=name)).to_be_focused()
            page.keyboard.press("Tab" if name != "Start" else "Enter")
        expect(page.locator("#pause")).to_be_enabled()
        tab_to(page, "full")
        page.keyboard.press("Enter")
        expect(page.locator("#screen:fullscreen")).to_be_focused()
        expect(page.locator(".controls")).to_have_css("opacity", "0")
        reached = []
        for _ in range(9):
            page.keyboard.press("Tab")
            name, on_top = page.evaluate(ON_TOP)
            reached.append(name)
            assert on_top, f"{name} has the focus and is not visible"
        assert {"pause", "full", "again"} <= {*reached}
        tab_to(page, "pause")
        page.keyboard.press("Enter")
        expect(page.locator("#pause")).to_have_text("Resume")
        page.keyboard.press("Escape")
        expect(page.locator(":fullscreen")).to_have_count(0)
        expect(page.locator("#pause")).to_be_disabled()
        expect(page.locator("#send")).to_be_focused()
        walk(page)


def test_page_receives_from_a_camera_by_keyboard(chromium: Browser, address: str, tmp_path: Path) -> None:
    phone = Phone(width=320, height=240, side_px=160.0, blur_px=0.8, seed=12)
    light = shown(sending_of(b"keys", None, 16, 15.0), 4.0, cell_px=12)
    write_webcam(webcam := tmp_path / "webcam.mjpeg", phone_frames(light, phone))
    with browser(chromium.browser_type, *webcam_of(webcam)) as found, quiet_page(found, f"{address}receive") as page:
        tab_to(page, "start")
        page.keyboard.press("Enter")
        expect(page.locator("#start")).to_have_text("Stop the camera")
        expect(page.locator("#start")).to_be_focused()
        expect(page.locator(".text")).to_have_text("keys")
        walk(page)
        for _ in range(99):
            if page.evaluate("document.activeElement.textContent") == "Copy":
                break
            page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        expect(page.get_by_role("button", name="Copied")).to_be_focused()
        tab_to(page, "stop")
        page.keyboard.press("Enter")
        expect(page.locator("#start")).to_have_text("Start the camera")
        expect(page.locator("#stop")).to_be_hidden()
        expect(page.locator("#start")).to_be_focused()


def test_page_receive_by_keyboard(chromium: Browser, address: str) -> None:
    with quiet_page(chromium, f"{address}receive") as page:
        walk(page)
        page.evaluate(CLICK)
        tab_to(page, "film")
        page.keyboard.press("Enter")
        expect(page.locator("#film")).to_have_attribute("data-clicked", "true")
        for summary in page.locator("summary").all():
            summary.focus()
            page.keyboard.press("Space")
        walk(page)
        tab_to(page, "start")
        page.keyboard.press("Enter")
        expect(page.locator(".notice.bad")).to_contain_text("no camera")
