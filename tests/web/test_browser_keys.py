"""The pages are operated by keyboard only, in a real browser."""

from collections.abc import Iterator
from typing import Any

import pytest

pytest.importorskip("playwright", reason="playwright is not installed: pip install playwright")

from browsers import needs_chromium, quiet_page
from playwright.sync_api import Browser, Page, expect
from web_server import serving

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
