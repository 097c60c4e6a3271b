"""Send text and a picture from page *Transmit* through a phone film to page *Receive*, in a real browser."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("playwright", reason="playwright is not installed: pip install playwright")

from browsers import (
    DISPLAY,
    SMALL_TARGETS,
    browser,
    check_accessibility,
    grabbed,
    needs_chromium,
    quiet_page,
    webcam_of,
)
from cli_runs import succeeded, within
from playwright.sync_api import Browser, Page, Route, expect
from screen_films import Phone, phone_frames, write_phone_film, write_webcam
from screen_light import shown
from waiting import wait_until
from web_server import serving

from heliograph.media import open_film
from heliograph.web.security import LOOPBACK, Access
from heliograph.web.sending import sending_of

pytestmark = [pytest.mark.slow, needs_chromium]
TEXT = "Grüße vom Bildschirm: 18 °C, 42 % ☀"
PHONE = Phone(width=320, height=240, side_px=160.0, blur_px=0.8, seed=3)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with serving() as url:
        yield url


@contextmanager
def transmit_page(chromium: Browser, address: str, **options: str) -> Iterator[Page]:
    with quiet_page(chromium, f"{address}transmit", **options) as page:
        page.wait_for_selector("#rate option", state="attached")
        yield page


@contextmanager
def displayed_page(chromium: Browser, address: str) -> Iterator[Page]:
    """Yield page *Transmit* on a display that tests refresh; see `grabbed`."""
    with quiet_page(chromium, f"{address}transmit", DISPLAY) as page:
        page.evaluate("() => { for (let k = 0; k < 40; k += 1) refresh(); }")  # the page measures its display
        yield page


def transmitting(page: Page, cells: str = "16") -> None:
    page.wait_for_selector("#rate option", state="attached")
    page.select_option("#rate", label="15")
    page.select_option("#side", cells)
    page.click("#send")
    page.get_by_role("dialog").get_by_role("button", name="Start").click()
    page.wait_for_selector("#pause:enabled")


def light_of(page: Page) -> int:
    return int(page.evaluate(
        "() => { const shown = document.getElementById('array');"
        " const copy = new OffscreenCanvas(shown.width, shown.height).getContext('2d', { willReadFrequently: true });"
        " copy.drawImage(shown, 0, 0);"
        " return copy.getImageData(0, 0, shown.width, shown.height).data.filter((_, k) => k % 4 < 3)"
        ".reduce((most, value) => Math.max(most, value), 0); }"
    ))  # fmt: skip


@pytest.fixture(scope="module")
def sent(chromium: Browser, address: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, bytes]:
    """A phone film of page *Transmit* that sends a picture, and the picture."""
    folder = tmp_path_factory.mktemp("sent")
    film, picture = folder / "phone.mp4", folder / "sun.png"
    drawn = np.full((24, 24), 30, np.uint8)
    cv2.circle(drawn, (12, 12), 8, 220, -1)
    cv2.imwrite(str(picture), drawn)
    with displayed_page(chromium, address) as page:
        page.check("input[value=file]")
        page.set_input_files("#file", picture)
        transmitting(page, "20")
        write_phone_film(film, phone_frames(grabbed(page, 4.0), PHONE), PHONE)
        expect(page.locator("#facts")).to_contain_text("as a file")
    return film, picture.read_bytes()


def test_command_receives_a_phone_film_of_the_page(sent: tuple[Path, bytes], tmp_path: Path) -> None:
    film, picture = sent
    succeeded(within(tmp_path, "receive", film, "--preset", "phone", "--set", "signal.side=20", "--output", "got"))
    assert (tmp_path / "got" / "files" / "sun.png").read_bytes() == picture


def test_preview_is_still_and_states_the_film_time(chromium: Browser, address: str) -> None:
    with quiet_page(chromium, f"{address}transmit") as page:
        picture = "document.getElementById('pattern').toDataURL()"
        expect(page.locator("#estimate")).to_contain_text("23 B in 1 packet, 27 bytes per second: film for 7 s")
        expect(page.locator("#pattern")).to_be_visible()
        assert light_of(page) == 0
        before = page.evaluate(picture)
        page.fill("#text", "Another text")
        expect(page.locator("#estimate")).to_contain_text("12 B")
        after = page.evaluate(picture)
        assert after != before
        page.wait_for_timeout(1000)
        assert page.evaluate(picture) == after
        page.locator(".light summary").click()
        page.check("#single")
        expect(page.locator("#estimate")).to_contain_text("12 B in 1 packet, 61 bytes per second")
        expect(page.locator("#single-said")).to_have_text("61 bytes per second")
        page.fill("#text", "")
        expect(page.locator("#pattern")).to_be_hidden()
        expect(page.locator(".notice")).to_be_hidden()


def test_full_screen_begins_with_an_instruction_and_counts_packets(chromium: Browser, address: str) -> None:
    with transmit_page(chromium, address) as page:
        page.fill("#text", "long text " * 20)
        transmitting(page)
        expect(page.locator("#preview")).to_be_hidden()
        expect(page.locator("#turn-said")).to_contain_text("Packet 1 of 3")
        page.click("#full")
        instruction = page.locator("#instruction")
        expect(instruction).to_have_text(
            "Film this screen with your phone, held still, for 10 s, or point a webcam at it: page Receive, “Start the "
            "camera”. Esc stops and returns to the page."
        )
        expect(instruction).to_be_visible()
        check_accessibility(page)
        page.wait_for_timeout(3100)
        expect(instruction).to_be_hidden()
        expect(page.locator("#corner")).to_be_visible()
        expect(page.locator("#corner")).to_contain_text("of 3")
        page.evaluate("() => document.exitFullscreen()")  # as the browser does on Esc
        expect(page.locator("#turn")).to_be_hidden()
        expect(page.locator("#preview")).to_be_visible()


def test_code_opens_page_receive_on_a_phone(chromium: Browser, address: str) -> None:
    with quiet_page(chromium, f"{address}transmit") as page:
        expect(page.locator("#phone")).to_contain_text("Open only in a network that you trust")
        expect(page.locator("#code")).to_be_hidden()
    url = "http://192.168.1.5:8000/receive#token=secret"
    with (
        serving(access=Access(LOOPBACK, token="secret"), phone_url=url) as served,
        quiet_page(chromium, f"{served}transmit#token=secret") as page,
    ):
        assert wait_until(lambda: read_code(page.locator("#code").screenshot())) == url
        check_accessibility(page)
        expect(page.locator("#open-network")).to_be_visible()


def test_button_opens_the_server_to_the_network_and_closes_it(
    chromium: Browser, address: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heliograph.web.serve._local_address", lambda: "127.0.0.2")
    with quiet_page(chromium, f"{address}transmit") as page:
        page.get_by_role("button", name="Open to the network").press("Enter")
        url = wait_until(lambda: read_code(page.locator("#code").screenshot()))
        check_accessibility(page)
        assert url.startswith("http://127.0.0.2:")
        with quiet_page(chromium, url) as phone:
            expect(phone.locator("h1")).to_have_text("Receive")
        page.get_by_role("button", name="Close to the network").click()
        expect(page.locator("#code")).to_be_hidden()
        expect(page.get_by_role("button", name="Open to the network")).to_be_enabled()


def read_code(screenshot: bytes) -> str:
    """Return the text of a QR code, empty while the page still draws it."""
    code = cv2.imdecode(np.frombuffer(screenshot, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert code is not None
    return cv2.QRCodeDetector().detectAndDecode(code)[0]


def test_likely_problem_is_shown_before_the_diagnosis(chromium: Browser, address: str, tmp_path: Path) -> None:
    burnt, film = replace(PHONE, gain=8.0), tmp_path / "burnt.mp4"
    light = shown(sending_of(b"burnt", None, 16, 15.0), 4.0, cell_px=12)
    write_phone_film(film, phone_frames(light, burnt), burnt)
    with quiet_page(chromium, f"{address}receive") as page:
        page.set_input_files("#film", film)
        expect(page.locator("#why-title")).to_contain_text("Likely problem")
        expect(page.locator("#why-lines")).to_contain_text("Exposure: ")
        expect(page.locator("#state")).not_to_contain_text("The end")
        expect(page.locator("#state")).to_contain_text("The end")
        expect(page.locator("#why-title")).to_have_text("Why nothing was received")


def test_camera_of_the_browser_receives_from_page_transmit(chromium: Browser, address: str, tmp_path: Path) -> None:
    webcam = tmp_path / "phone.mjpeg"
    with displayed_page(chromium, address) as page:
        page.fill("#text", TEXT)
        transmitting(page)
        write_webcam(webcam, phone_frames(grabbed(page, 4.0), PHONE))
    with browser(chromium.browser_type, *webcam_of(webcam)) as found, quiet_page(found, f"{address}receive") as page:
        page.click("#start")
        expect(page.locator("#outline")).to_have_attribute("points", re.compile(r"[\d.]+( [\d.]+){7}"))
        expect(page.locator("#overlay.read")).to_have_count(0)
        expect(page.locator(".text")).to_have_text(TEXT)
        expect(page.locator(".text")).to_be_in_viewport()
        expect(page.locator("#overlay")).to_have_class("overlay read")
        expect(page.locator("#state")).to_have_text("Receiving …")
        expect(page.locator("#why")).to_be_hidden()
        page.get_by_role("button", name="Copy").click()
        expect(page.get_by_role("button", name="Copied")).to_be_visible()
        expect(page.locator("#counts")).to_contain_text("sent")
        page.evaluate("""Object.defineProperty(document, "hidden", {value: true});
            document.dispatchEvent(new Event("visibilitychange"))""")
        expect(page.locator(".notice")).to_contain_text("This page was hidden")
        page.click("#stop")
        expect(page.locator("#start")).to_have_text("Start the camera")


def test_picture_is_received_from_a_film_that_replaces_an_upload(
    sent: tuple[Path, bytes], chromium: Browser, address: str, tmp_path: Path
) -> None:
    film, picture = sent
    (none := tmp_path / "none.mp4").write_bytes(bytes(1000))
    with quiet_page(chromium, f"{address}receive") as page:
        held: list[Route] = []
        page.route("**/api/films?*", lambda route: route.continue_() if held else held.append(route))
        page.set_input_files("#film", none)
        while not held:
            page.wait_for_timeout(20)
        page.set_input_files("#film", film)  # during the first upload
        expect(page.locator("#got img")).to_be_visible()
        expect(page.locator("#got")).to_contain_text("File sun.png")
        expect(page.locator("#state")).to_contain_text("The end.")
        expect(page.locator(".notice")).to_be_hidden()
        with page.expect_download() as saved:
            page.get_by_role("button", name="Save sun.png").click()
        assert Path(saved.value.path()).read_bytes() == picture
        check_accessibility(page)
        page.set_input_files("#film", none)  # in reverse order, earlier results disappear
        expect(page.locator(".notice.bad")).to_contain_text("The film")
        check_accessibility(page)


def test_transmit_obeys_keys_and_counts_skipped_refreshes(chromium: Browser, address: str) -> None:
    with transmit_page(chromium, address) as page:
        page.press("#send", "Enter")
        page.get_by_role("dialog").get_by_role("button", name="Start").click()
        expect(page.locator("#pause")).to_be_enabled()
        page.fill("#text", "Another text")
        expect(page.locator("#send")).to_have_text("Send changes")
        page.click("#send")
        expect(page.locator("#send")).to_have_text("Send")
        page.press("#main", "Space")
        expect(page.locator("#pause")).to_have_text("Resume")
        page.keyboard.press("Space")
        expect(page.locator("#pause")).to_have_text("Pause")
        page.keyboard.press("f")
        expect(page.locator(":fullscreen")).not_to_have_count(0)
        page.keyboard.press("f")
        expect(page.locator(":fullscreen")).to_have_count(0)
        page.evaluate("() => { const until = performance.now() + 900; while (performance.now() < until); }")
        expect(page.locator(".notice")).to_contain_text("Choose a lower rate")
        expect(page.locator(".notice")).to_contain_text("Choose a lower rate: 5 patterns per second.")
        assert int(page.inner_text("[data-lost] td")) >= 3
        page.keyboard.press("f")  # the full screen hides the notice
        expect(page.locator(":fullscreen")).not_to_have_count(0)
        page.evaluate("() => { const until = performance.now() + 900; while (performance.now() < until); }")
        expect(page.locator("#corner")).to_contain_text("Choose a lower rate: 5 patterns per second.")


def test_nothing_flashes_without_consent_and_escape_stops_at_once(chromium: Browser, address: str) -> None:
    with transmit_page(chromium, address) as page:
        page.click("#send")
        dialog = page.get_by_role("dialog")
        expect(dialog).to_contain_text("photosensitive epilepsy")
        expect(dialog.get_by_role("button", name="Cancel")).to_be_focused()
        check_accessibility(page)
        page.keyboard.press("Escape")
        expect(dialog).to_be_hidden()
        assert light_of(page) == 0
        expect(page.locator("#pause")).to_be_disabled()
        page.click("#send")
        dialog.get_by_role("button", name="Start").click()
        page.wait_for_function("() => !document.getElementById('pause').disabled")
        while light_of(page) == 0:
            page.wait_for_timeout(20)
        page.press("#text", "Escape")
        assert light_of(page) == 0
        page.click("#send")  # asks only once
        expect(page.locator("#pause")).to_be_enabled()
        expect(dialog).to_be_hidden()
        page.click("#full")
        expect(page.locator(":fullscreen")).not_to_have_count(0)
        page.evaluate("() => document.exitFullscreen()")  # as the browser does on Esc
        expect(page.locator("#pause")).to_be_disabled()
        assert light_of(page) == 0


def test_reduced_motion_sends_slowly_and_asks_every_time(chromium: Browser, address: str) -> None:
    with transmit_page(chromium, address, reduced_motion="reduce") as page:
        expect(page.locator("#rate option:checked")).to_have_text("2")
        page.select_option("#rate", label="10")
        for _ in range(2):
            page.click("#send")
            page.get_by_role("dialog").get_by_role("button", name="Send slowly, 1 per second").click()
            expect(page.locator("#pause")).to_be_enabled()
            expect(page.locator("#rate option:checked")).to_have_text("2")
            expect(page.locator("#array")).to_have_attribute("aria-label", "Patterns of 16 × 16 cells, 2.0 a second")


@pytest.mark.parametrize("page_name", ["transmit", "receive"])
def test_a_file_dropped_anywhere_is_taken(chromium: Browser, address: str, page_name: str) -> None:
    with quiet_page(chromium, address + page_name) as page:
        page.wait_for_load_state("networkidle")
        is_kept = page.evaluate("""() => {
          const dataTransfer = new DataTransfer();
          dataTransfer.items.add(new File(["no film"], "dropped.mp4"));
          return !document.querySelector("h1").dispatchEvent(
            new DragEvent("drop", { dataTransfer, bubbles: true, cancelable: true }));
        }""")
        assert is_kept, "the browser would leave the page for the file"
        if page_name == "transmit":
            assert page.evaluate("document.getElementById('file').files[0].name") == "dropped.mp4"
            expect(page.locator("#file-part")).to_be_visible()
        else:
            expect(page.locator(".notice.bad")).to_contain_text("is not a video that can be read")


def test_empty_and_large_files_are_refused_in_the_page(chromium: Browser, address: str, tmp_path: Path) -> None:
    with transmit_page(chromium, address) as page:
        page.check("input[value=file]")
        for name, size, message in (("empty.txt", 0, "is empty"), ("large.bin", 400_000, "at most 256 kB")):
            (path := tmp_path / name).write_bytes(bytes(size))
            page.set_input_files("#file", path)
            page.click("#send")
            expect(page.locator(".notice.bad")).to_contain_text(message)


def test_frames_of_a_still_film_are_saved_by_a_button(chromium: Browser, address: str, tmp_path: Path) -> None:
    frames = [(k / 30, np.full((64, 64), 90, np.uint8)) for k in range(75)]
    write_phone_film(tmp_path / "still.mp4", frames, Phone(width=64, height=64))
    with quiet_page(chromium, f"{address}receive") as page:
        page.set_input_files("#film", tmp_path / "still.mp4")
        expect(page.locator("#state")).to_contain_text("The end")
        expect(page.locator("#why-lines li").first).to_be_visible()
        check_accessibility(page)
        with page.expect_download() as saved:
            page.get_by_role("button", name=re.compile(r"Save what failed \([\d.]+ [kM]B\)")).click()
        saved.value.save_as(tmp_path / "failed.h5")
        expect(page.locator(".notice")).to_contain_text("Saved as failed.h5")
    with open_film(tmp_path / "failed.h5") as film:
        assert sum(1 for _ in film) > 60


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("page_name", ["", "transmit", "receive", "glossary"])
def test_page_is_accessible_and_fits(chromium: Browser, address: str, page_name: str, width: int) -> None:
    with quiet_page(chromium, address + page_name, viewport={"width": width, "height": 800}) as page:
        for details in page.locator("details").all():
            details.evaluate("one => { one.open = true; }")
        if page_name == "transmit":
            transmitting(page)
        elif page_name == "receive":
            page.evaluate("() => { document.getElementById('why').hidden = false; }")
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            check_accessibility(page)
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        assert page.evaluate(SMALL_TARGETS) == []
