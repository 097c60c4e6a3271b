"""Page *Watch* plays the demonstration film in a real browser, and is accessible."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from cli_runs import SMALL

from heliograph.experiments.demo.drive import demo_messages
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.media import open_film

axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="pip install axe-playwright-python")
browsers = pytest.importorskip("browsers", reason="playwright is not installed: pip install playwright")

pytestmark = [pytest.mark.slow, browsers.needs_chromium]

PHONE: dict[str, Any] = {"viewport": {"width": 390, "height": 844}, "color_scheme": "dark"}
DESK: dict[str, Any] = {"viewport": {"width": 1280, "height": 900}, "color_scheme": "light"}


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("films") / "demo.h5"
    settings = load_settings("static", None, [*SMALL[3::2], "channel.duration_s=1.25"])
    write_film(path, settings, demo_messages(settings), seed=1)
    return path


@pytest.fixture(scope="module")
def address(film: Path) -> Iterator[str]:
    with browsers.served(str(film)) as url:
        yield url


@pytest.fixture(scope="module")
def found() -> Iterator[Any]:
    with browsers.browser() as launched:
        yield launched


def to_the_end(page: Any) -> None:
    page.wait_for_selector("#named option", state="attached")
    page.click("#open")
    page.get_by_text("The end: 1250 frames").wait_for()
    page.wait_for_timeout(300)


@pytest.mark.parametrize("looks", [DESK, PHONE], ids=["desk", "phone"])
def test_all_that_was_received_is_shown_and_named(found: Any, address: str, looks: dict[str, Any]) -> None:
    with browsers.quiet_page(found, f"{address}watch", **looks) as page:
        to_the_end(page)
        assert page.inner_text("#arrays tbody").startswith("array 0")
        assert page.locator("#packets li").count() == 12
        assert "red for 12 s" in page.inner_text("#messages")
        assert page.evaluate("document.querySelector('#picture img').naturalWidth") == 96  # the second, sharper picture
        assert "array 0 at" in (page.get_attribute("#frame", "aria-label") or "")
        for name in ("received", "equalised", "decided"):
            assert "levels" in (page.get_attribute(f"#{name}", "aria-label") or "")
        assert "0 of" in page.inner_text("#errors")
        assert "following" in page.inner_text("#stages")
        assert page.evaluate("document.documentElement.scrollWidth") <= looks["viewport"]["width"]
        assert not axe.Axe().run(page).response["violations"]


def test_lights_that_were_told_of_are_drawn(found: Any, address: str) -> None:
    pytest.importorskip("pycrate_asn1dir", reason="the extra its is not installed")
    with browsers.quiet_page(found, f"{address}watch", **DESK) as page:
        to_the_end(page)
        assert "Junction 7, Harbour Road" in page.inner_text("#lights")
        assert page.locator("#lights svg .lamp.red").count() >= 1
        assert page.locator("#lights svg .way.green").count() >= 1


def test_it_is_stepped_through_and_looked_back_on_by_keyboard(
    found: Any, address: str, film: Path, tmp_path: Path
) -> None:
    with browsers.quiet_page(found, f"{address}watch", **DESK) as page:
        page.wait_for_selector("#named option", state="attached")
        page.select_option("#speed", "0.1")
        page.focus("#open")
        page.keyboard.press("Enter")
        page.wait_for_selector("#packets li")
        page.focus("#frame-box")
        page.keyboard.press("Space")
        page.get_by_role("button", name="Go on").wait_for()
        page.wait_for_timeout(300)
        before = page.inner_text("#where")
        page.keyboard.press(".")
        while page.inner_text("#where") == before:
            page.wait_for_timeout(50)
        page.focus("#scrub")
        page.keyboard.press("Home")
        page.get_by_text("(recorded)").wait_for()
        assert page.locator("#packets li").count() == 0
        page.focus("#frame-box")
        page.keyboard.press("Home")
        page.get_by_role("cell", name="nearing").or_(page.get_by_role("cell", name="m")).first.wait_for()
        with page.expect_download() as saved:
            page.click("#save")
        saved.value.save_as(tmp_path / "failed.h5")
    with open_film(tmp_path / "failed.h5") as kept:
        assert sum(1 for _ in kept) > 50


def test_counts_from_before_a_pause_do_not_undo_it(found: Any, address: str) -> None:
    to_page: list[Any] = []
    counts: list[str] = []

    def passed_on(socket: Any) -> None:
        def heard(message: str | bytes) -> None:
            if isinstance(message, str) and '"event": "state"' in message:
                counts.append(message)
            socket.send(message)

        to_page.append(socket)
        socket.connect_to_server().on_message(heard)

    with browsers.quiet_page(found, f"{address}watch", **DESK) as page:
        page.route_web_socket("**/api/watch*", passed_on)
        page.wait_for_selector("#named option", state="attached")
        page.select_option("#speed", "0.1")
        page.click("#open")
        page.wait_for_selector("#packets li")
        page.get_by_role("button", name="Pause").click()
        assert json.loads(counts[0])["paused"] is False
        to_page[0].send(counts[0])
        page.wait_for_timeout(300)
        page.get_by_role("button", name="Go on").click()
        page.get_by_text("The end: 1250 frames, 12 packets").wait_for()


def test_a_film_that_is_dropped_is_decoded(found: Any, address: str, film: Path, tmp_path: Path) -> None:
    with browsers.quiet_page(found, f"{address}watch", **DESK) as page:
        page.wait_for_selector("#named option", state="attached")
        page.check("input[value=film]")
        page.set_input_files("#film", film)
        page.click("#open")
        page.get_by_text("The end: 1250 frames, 12 packets").wait_for()
        assert "not known" in page.inner_text("#errors")
        # for an unreadable film, the page is empty, and earlier results are cleared
        (broken := tmp_path / "broken.mp4").write_bytes(b"no film")
        page.set_input_files("#film", broken)
        page.click("#open")
        page.get_by_role("alert").wait_for()
        page.get_by_text("Nothing yet.").wait_for()
        assert page.locator("#packets li").count() == 0
        assert "Where the truth is known" in page.inner_text("#errors")
