"""Page *Watch* plays the demonstration film in a real browser; the pages show exceptions of the server in a line."""

import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("playwright", reason="playwright is not installed: pip install playwright")

from browsers import SMALL_TARGETS, check_accessibility, needs_chromium, quiet_page
from cli_runs import SMALL
from playwright.sync_api import Browser, Page, WebSocketRoute, expect
from web_server import serving

from heliograph.experiments.demo import demo_messages
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.media import open_film
from heliograph.web.built import built

pytestmark = [pytest.mark.slow, needs_chromium]
PHONE: dict[str, Any] = {"viewport": {"width": 390, "height": 844}, "color_scheme": "dark"}
DESK: dict[str, Any] = {"viewport": {"width": 1280, "height": 800}, "color_scheme": "light"}


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A film with the messages of the demonstration, and a short film."""
    folder, paths = tmp_path_factory.mktemp("films"), list[Path]()
    for name, seconds in (("demo.h5", 1.25), ("short.h5", 0.35)):
        settings = load_settings("static", None, [*SMALL[3::2], f"channel.duration_s={seconds}"])
        write_film(folder / name, settings, demo_messages(settings), seed=1)
        paths.append(folder / name)
    return paths


@pytest.fixture(scope="module")
def address(films: list[Path]) -> Iterator[str]:
    with serving(films) as url:
        yield url


SLOW_PICTURES = """
    const decode = createImageBitmap;
    let count = 0;
    window.drawn = [];
    window.createImageBitmap = async (...given) => {
      const picture = await decode(...given);
      if (count++ % 3 === 0) await new Promise((done) => setTimeout(done, 40));
      return picture;
    };
    addEventListener("DOMContentLoaded", () => {
      const frame = document.getElementById("frame");
      const note = () => window.drawn.push(Number(/Frame (\\d+)/.exec(frame.ariaLabel)?.[1] ?? -1));
      new MutationObserver(note).observe(frame, { attributeFilter: ["aria-label"] });
    });
"""
"""Every third picture is decoded late, and the numbers of the drawn frames are kept."""


@contextmanager
def watch_page(chromium: Browser, address: str, script: str = "", speed: str = "") -> Iterator[Page]:
    """Yield page *Watch* with its sources, and a speed chosen."""
    with quiet_page(chromium, f"{address}watch", script, **DESK) as page:
        page.wait_for_selector("#kind option", state="attached")
        if speed:
            page.select_option("#speed", speed)
        yield page


@pytest.fixture(scope="module")
def ended(chromium: Browser, address: str) -> Iterator[Page]:
    """The page at the end of the film."""
    with watch_page(chromium, address, SLOW_PICTURES) as page:
        page.click("#open")
        page.get_by_text("End: 1250 frames, 12 packets.").wait_for()
        page.click("#details > summary")
        # the second, sharper picture
        expect(page.locator("#picture img").first).to_have_js_property("naturalWidth", 96)
        caption = re.compile(r"complete at \d\.\d\d s, \d+ m away: picture 2, ")
        expect(page.locator("#picture figcaption")).to_contain_text(caption)
        yield page


def test_results_of_a_reception_are_shown_named_and_drawn_in_order(ended: Page) -> None:
    assert ended.inner_text("#arrays tbody").startswith("array 0")
    assert ended.locator("#packets li").count() == 12
    assert "red for 12 s" in ended.inner_text("#messages")
    assert "array 0 at" in (ended.get_attribute("#frame", "aria-label") or "")
    for name in ("received", "equalised", "decided"):
        assert "levels" in (ended.get_attribute(f"#{name}", "aria-label") or "")
    assert "0 of" in ended.inner_text("#errors")
    assert "tracking" in ended.inner_text("#stages")
    drawn = [number for number in ended.evaluate("window.drawn") if number >= 0]
    assert len(drawn) > 3
    assert drawn == sorted(drawn)


@pytest.mark.parametrize("looks", [DESK, PHONE], ids=["desk", "phone"])
def test_page_is_accessible_and_fits_the_screen(ended: Page, looks: dict[str, Any]) -> None:
    ended.set_viewport_size(looks["viewport"])
    ended.emulate_media(color_scheme=looks["color_scheme"])
    assert ended.evaluate("document.documentElement.scrollWidth") <= looks["viewport"]["width"]
    check_accessibility(ended)


def test_announced_traffic_lights_are_drawn(ended: Page) -> None:
    pytest.importorskip("pycrate_asn1dir", reason="the extra its is not installed")
    assert "Junction 7, Harbour Road" in ended.inner_text("#lights")
    assert ended.locator("#lights svg .lamp.red").count() >= 1
    assert ended.locator("#lights svg .way.green").count() >= 1


def boxes(page: Page, *names: str) -> list[dict[str, float]]:
    return [page.locator(f"#{name}").bounding_box() or {} for name in names]  # type: ignore[misc]


@pytest.fixture(scope="module")
def playing(chromium: Browser, address: str) -> Iterator[Page]:
    """The page in the middle of the film."""
    with watch_page(chromium, address, speed="0.1") as page:
        page.click("#open")
        page.wait_for_selector("#ticks rect")
        yield page


def test_frame_controls_timeline_and_results_are_visible_together(playing: Page) -> None:
    playing.set_viewport_size(DESK["viewport"])
    assert playing.evaluate("scrollY") == 0
    frame, pause, ticks, results = boxes(playing, "frame", "pause", "ticks", "messages")
    for box in (frame, pause, ticks, results):
        assert box["y"] > 0
        assert box["y"] + box["height"] <= 800
    assert frame["y"] + frame["height"] <= pause["y"] < ticks["y"]
    assert frame["x"] + frame["width"] < results["x"]
    assert not playing.evaluate("document.getElementById('source-box').open")


def test_frame_comes_first_on_a_phone(playing: Page) -> None:
    playing.set_viewport_size(PHONE["viewport"])
    names = ("frame", "pause", "ticks", "arrived-title", "sure-title", "details")
    tops = [box["y"] for box in boxes(playing, *names)]
    assert tops == sorted(tops)
    assert tops[0] < 200
    assert tops[2] < 844
    check_accessibility(playing)
    assert not playing.evaluate(SMALL_TARGETS)


def test_timeline_has_a_mark_by_packet_and_layer(ended: Page) -> None:
    ended.set_viewport_size(DESK["viewport"])
    for layer in ("high", "middle", "low"):
        expect(ended.locator(f"#ticks rect.{layer}")).to_have_count(12)
    assert "12 packets: high layer" in (ended.get_attribute("#ticks", "aria-label") or "")
    ended.locator("#scrub").click(position={"x": 60, "y": 30})
    expect(ended.locator("#where")).to_contain_text("(recorded)")
    first = ended.inner_text("#where")
    ended.keyboard.press("ArrowRight")
    expect(ended.locator("#where")).not_to_have_text(first)
    ended.click("#live")
    expect(ended.locator("#where")).not_to_contain_text("(recorded)")
    assert ended.locator("#bits .point.high").count() >= 12


def test_frame_is_zoomed_by_buttons_keys_and_wheel(ended: Page) -> None:
    ended.set_viewport_size(DESK["viewport"])
    zoom = ended.locator("#zoom-fit")
    ended.click("#zoom-in")
    expect(zoom).to_have_text("1.5×")
    ended.press("#frame-box", "+")
    expect(zoom).not_to_have_text("1.5×")
    ended.keyboard.press("0")
    expect(zoom).to_have_text("1×")
    frame = boxes(ended, "frame")[0]
    ended.mouse.move(frame["x"] + 50, frame["y"] + 50)
    ended.mouse.wheel(0, -480)
    expect(zoom).to_have_text("4×")
    shown = ended.evaluate("document.getElementById('frame').toDataURL()")
    ended.mouse.down()
    ended.mouse.move(frame["x"] + 10, frame["y"] + 20, steps=3)
    ended.mouse.up()
    assert ended.evaluate("document.getElementById('frame').toDataURL()") != shown
    ended.click("#zoom-fit")
    expect(zoom).to_have_text("1×")


def test_help_opens_by_keyboard_and_leads_to_the_glossary(playing: Page) -> None:
    playing.set_viewport_size(DESK["viewport"])
    playing.get_by_label("Help: timeline").focus()
    playing.keyboard.press("Enter")
    link = playing.get_by_role("link", name="Glossary")
    assert link.get_attribute("href") == "glossary#packet"
    playing.keyboard.press("Escape")
    expect(link).to_have_count(0)
    for panel in playing.locator("h2:not(.said), .title > h3").all():
        assert panel.locator("xpath=..").locator("details.help").count() or panel.inner_text() == "Details"
    for href in playing.evaluate("[...document.querySelectorAll('.help a')].map((link) => link.getAttribute('href'))"):
        assert f'id="{href.partition("#")[2]}"' in built()["glossary.html"].decode()


def test_reload_and_back_restore_source_and_moment(chromium: Browser, address: str) -> None:
    with watch_page(chromium, address, speed="0.1") as page:
        page.click("#open")
        page.wait_for_selector("#packets li", state="attached")
        page.press("#frame-box", "Space")
        page.wait_for_timeout(700)
        where = page.inner_text("#where")
        page.reload()
        expect(page.locator("#where")).to_have_text(where)
        expect(page.locator("#source-line")).to_contain_text("demo.h5")
        page.get_by_role("button", name="Resume").wait_for()
        expect(page.locator("#working")).to_be_hidden()
        page.click("#source-box > summary")
        page.select_option("#kind", "named 1")
        page.click("#open")
        expect(page.locator("#source-line")).to_contain_text("short.h5")
        page.go_back()
        expect(page.locator("#source-line")).to_contain_text("demo.h5")
        expect(page.locator("#where")).to_have_text(where)


def test_recorded_drive_plays_at_once_unless_the_visitor_wants_reduced_motion(chromium: Browser) -> None:
    with serving() as url, quiet_page(chromium, f"{url}watch", **PHONE) as page:
        page.wait_for_selector("#frame[aria-label^='Frame']")
        # a packet of 100 frames: a slow browser may see the end only
        page.wait_for_selector("#packets li", state="attached")
        expect(page.locator("#source-line")).to_contain_text("recorded-drive.mp4")
        with quiet_page(chromium, f"{url}watch", **PHONE, reduced_motion="reduce") as still:
            still.wait_for_selector("#kind option", state="attached")
            still.get_by_role("button", name="Play").click()
            still.wait_for_selector("#frame[aria-label^='Frame']")


def test_keys_step_through_a_film_and_look_back(chromium: Browser, address: str, tmp_path: Path) -> None:
    with watch_page(chromium, address, speed="0.1") as page:
        page.press("#open", "Enter")
        page.wait_for_selector("#packets li", state="attached")
        page.press("#frame-box", "Space")
        page.get_by_role("button", name="Resume").wait_for()
        page.wait_for_timeout(300)
        before = page.inner_text("#where")
        page.keyboard.press(".")
        while page.inner_text("#where") == before:
            page.wait_for_timeout(50)
        page.press("#scrub", "Home")
        page.get_by_text("(recorded)").wait_for()
        assert page.locator("#packets li").count() == 0
        page.press("#frame-box", "Home")
        expect(page.locator("#where")).not_to_contain_text("(recorded)")
        page.click("#details > summary")
        page.get_by_role("cell", name="approaching").or_(page.get_by_role("cell", name="m")).first.wait_for()
        with page.expect_download() as saved:
            page.click("#save")
        saved.value.save_as(tmp_path / "failed.h5")
    with open_film(tmp_path / "failed.h5") as kept:
        assert sum(1 for _ in kept) > 50


def test_counts_from_before_a_pause_do_not_undo_it(chromium: Browser, address: str) -> None:
    to_page: list[WebSocketRoute] = []
    counts: list[str] = []

    def connect(socket: WebSocketRoute) -> None:
        def forward(message: str | bytes) -> None:
            if isinstance(message, str) and '"event": "state"' in message:
                counts.append(message)
            socket.send(message)

        to_page.append(socket)
        socket.connect_to_server().on_message(forward)

    with quiet_page(chromium, f"{address}watch", **DESK) as page:
        page.route_web_socket("**/api/watch*", connect)
        page.wait_for_selector("#kind option", state="attached")
        page.select_option("#speed", "0.1")
        page.click("#open")
        page.wait_for_selector("#packets li", state="attached")
        page.get_by_role("button", name="Pause").click()
        assert json.loads(counts[0])["paused"] is False
        to_page[0].send(counts[0])
        page.wait_for_timeout(300)
        page.get_by_role("button", name="Resume").click()
        page.select_option("#speed", index=0)
        expect(page.locator("#packets li").nth(1)).to_be_attached()


def test_dropped_film_replaces_the_results(chromium: Browser, address: str, films: list[Path], tmp_path: Path) -> None:
    with watch_page(chromium, address) as page:
        page.select_option("#kind", "film")
        page.set_input_files("#film", films[1])
        page.click("#open")
        page.get_by_text("End: 350 frames, 3 packets").wait_for()
        assert "No ground truth" in (page.text_content("#errors") or "")
        # for an unreadable film, the page is empty, and earlier results are cleared
        (broken := tmp_path / "broken.mp4").write_bytes(b"no film")
        page.click("#source-box > summary")
        page.set_input_files("#film", broken)
        page.click("#open")
        page.get_by_role("alert").wait_for()
        page.get_by_text("No packet yet.").wait_for()
        assert page.locator("#packets li").count() == 0
        assert "Requires the ground truth" in (page.text_content("#errors") or "")


def broken(*_values: Any, **_named: Any) -> Any:
    raise ValueError("broken")


def expect_notice(page: Page) -> None:
    notice = page.locator(".notice[role=alert]")
    expect(notice).to_contain_text("The server failed by an internal error (ValueError: broken)")
    expect(notice).to_be_visible()


def test_watch_shows_a_crash_of_its_reception(chromium: Browser, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.watching.run.receive_and_count", broken)
    with watch_page(chromium, address) as page:
        page.click("#open")
        expect_notice(page)
        for button in ("stop", "step", "packet", "save"):
            expect(page.locator(f"#{button}")).to_be_disabled()
        expect(page.locator("#pause")).to_have_accessible_name("Play")
        expect_notice(page)  # the end of the connection keeps the notice


def test_page_receive_shows_a_crash_of_its_reception(
    chromium: Browser, address: str, dark_film: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heliograph.web.receive.PageReader.read_upload", broken)
    with quiet_page(chromium, f"{address}receive") as page:
        page.set_input_files("#film", dark_film)
        expect_notice(page)
        expect(page.locator("#state")).to_contain_text("Ended: ")
        expect(page.locator("#stop")).to_be_hidden()


def test_transmit_shows_a_crash_of_its_coding(chromium: Browser, address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.transmit.sending_of", broken)
    page = chromium.new_page()
    page.goto(f"{address}transmit")
    page.wait_for_selector("#rate option", state="attached")
    page.fill("#text", "hello")
    page.click("#send")
    page.get_by_role("dialog").get_by_role("button", name="Start").click()
    expect_notice(page)
    page.close()
