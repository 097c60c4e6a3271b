"""Send text and a picture from page *Transmit* through a phone film to page *Receive*, in a real browser."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("playwright", reason="playwright is not installed: pip install playwright")

from browsers import DISPLAY, browser, grabbed, needs_chromium, quiet_page, served, webcam_of
from cli_runs import called
from playwright.sync_api import Browser, Page, Playwright, Route, expect, sync_playwright
from screen_films import Gray, Phone, phone_frames, write_phone_film, write_webcam

from heliograph.media import open_film

pytestmark = [pytest.mark.slow, needs_chromium]

TEXT = "Grüße vom Bildschirm: 18 °C, 42 % ☀"
PHONE = Phone(width=320, height=240, side_px=160.0, blur_px=0.8, seed=3)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with served() as url:
        yield url


@pytest.fixture(scope="module")
def playwright() -> Iterator[Playwright]:
    with sync_playwright() as found:
        yield found


@pytest.fixture(scope="module")
def plain(playwright: Playwright) -> Iterator[Browser]:
    with browser(under=playwright) as found:
        yield found


def transmitting(page: Page, cells: str = "16") -> None:
    page.wait_for_selector("#rate option", state="attached")
    page.select_option("#rate", label="15")
    page.select_option("#side", cells)
    page.click("#send")
    page.wait_for_selector("#pause:enabled")


def filmed(page: Page, cells: str = "16") -> list[tuple[float, Gray]]:
    """Film the two packets that the page requests, with a phone."""
    page.evaluate("() => { for (let k = 0; k < 40; k += 1) refresh(); }")  # the page measures its display
    transmitting(page, cells)
    return list(phone_frames(grabbed(page, 4.0), PHONE))


@pytest.fixture(scope="module")
def text_frames(plain: Browser, address: str) -> list[tuple[float, Gray]]:
    with quiet_page(plain, f"{address}transmit", DISPLAY) as page:
        page.fill("#text", TEXT)
        return filmed(page)


@pytest.fixture(scope="module")
def picture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("picture") / "sun.png"
    drawn = np.full((24, 24), 30, np.uint8)
    cv2.circle(drawn, (12, 12), 8, 220, -1)
    cv2.imwrite(str(path), drawn)
    return path


def test_the_command_reads_what_a_phone_films_of_the_page(
    text_frames: list[tuple[float, Gray]], tmp_path: Path, capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    film = tmp_path / "phone.mp4"
    write_phone_film(film, text_frames, PHONE)
    out = tmp_path / "got"
    got = called(
        "receive", film, "--preset", "phone", "--output", out, capfd=capfd, monkeypatch=monkeypatch
    )  # fmt: skip
    assert got.returncode == 0, got.stderr
    assert {path.read_bytes().decode() for path in out.glob("array-0-*.bin")} == {TEXT}


def test_the_browsers_camera_reads_the_same(
    text_frames: list[tuple[float, Gray]], playwright: Playwright, address: str, tmp_path: Path
) -> None:
    webcam = tmp_path / "phone.mjpeg"
    write_webcam(webcam, text_frames)
    with browser(*webcam_of(webcam), under=playwright) as found, quiet_page(found, f"{address}receive") as page:
        page.click("#start")
        expect(page.locator(".text")).to_have_text(TEXT)
        expect(page.locator("#counts")).to_contain_text("sent")
        page.click("#stop")
        expect(page.locator("#start")).to_have_text("Start the camera")


def test_a_picture_is_uploaded_as_a_film_and_shown(plain: Browser, address: str, picture: Path, tmp_path: Path) -> None:
    film = tmp_path / "phone.mp4"
    with quiet_page(plain, f"{address}transmit", DISPLAY) as page:
        page.check("input[value=file]")
        page.set_input_files("#file", picture)
        write_phone_film(film, filmed(page, "20"), PHONE)
        expect(page.locator("#facts")).to_contain_text("as a file")
    with quiet_page(plain, f"{address}receive") as page:
        page.set_input_files("#film", film)
        shown = page.locator("#got img")
        expect(shown).to_be_visible()
        expect(page.locator("#got")).to_contain_text("File sun.png")
        expect(page.locator("#state")).to_contain_text("The end.")
        with page.expect_download() as saved:
            page.get_by_role("button", name="Save sun.png").click()
        assert Path(saved.value.path()).read_bytes() == picture.read_bytes()


def test_transmit_is_used_by_keys_alone_and_tells_what_it_skips(plain: Browser, address: str) -> None:
    with quiet_page(plain, f"{address}transmit") as page:
        page.wait_for_selector("#rate option", state="attached")
        page.focus("#send")
        page.keyboard.press("Enter")
        expect(page.locator("#pause")).to_be_enabled()
        page.focus("#main")
        page.keyboard.press("Space")
        expect(page.locator("#pause")).to_have_text("Go on")
        page.keyboard.press("Space")
        expect(page.locator("#pause")).to_have_text("Pause")
        page.keyboard.press("f")
        page.wait_for_function("document.fullscreenElement !== null")
        page.keyboard.press("f")
        page.wait_for_function("document.fullscreenElement === null")
        page.evaluate("() => { const until = performance.now() + 900; while (performance.now() < until); }")
        expect(page.locator(".notice")).to_contain_text("Choose a lower rate")
        assert int(page.inner_text("[data-lost] td")) >= 3


def sound_to_a_reader(page: Page) -> None:
    """Check accessibility with axe."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    found = axe.Axe().run(page)
    assert found.violations_count == 0, found.generate_report()


def test_what_failed_is_saved_by_its_button(
    plain: Browser, address: str, text_frames: list[tuple[float, Gray]], tmp_path: Path
) -> None:
    film = tmp_path / "white.mp4"
    white = [(t, np.clip(2.2 * one.astype(np.float32), 0, 255).astype(np.uint8)) for t, one in text_frames]
    write_phone_film(film, white, PHONE)
    with quiet_page(plain, f"{address}receive") as page:
        page.set_input_files("#film", film)
        expect(page.locator("#state")).to_contain_text("The end")
        expect(page.locator("#why-lines")).to_contain_text("Exposure: ")
        sound_to_a_reader(page)
        with page.expect_download() as saved:
            page.get_by_role("button", name="Save what failed").click()
        saved.value.save_as(tmp_path / "failed.h5")
        expect(page.locator(".notice")).to_contain_text("heliograph receive failed.h5 --preset phone")
    with open_film(tmp_path / "failed.h5") as saved_film:
        assert sum(1 for _ in saved_film) > 60


def test_a_film_that_is_chosen_instead_is_the_one_that_is_read(
    plain: Browser, address: str, text_frames: list[tuple[float, Gray]], tmp_path: Path
) -> None:
    film, none = tmp_path / "phone.mp4", tmp_path / "none.mp4"
    write_phone_film(film, text_frames, PHONE)
    none.write_bytes(bytes(1000))
    with quiet_page(plain, f"{address}receive") as page:
        held: list[Route] = []
        page.route("**/api/films?*", lambda route: route.continue_() if held else held.append(route))
        page.set_input_files("#film", none)
        while not held:
            page.wait_for_timeout(20)
        page.set_input_files("#film", film)  # during the first upload
        expect(page.locator(".text")).to_have_text(TEXT)
        expect(page.locator("#state")).to_contain_text("The end.")
        expect(page.locator(".notice")).to_be_hidden()
        sound_to_a_reader(page)
        page.set_input_files("#film", none)  # in reverse order, earlier results disappear
        expect(page.locator(".notice.bad")).to_contain_text("The film")
        sound_to_a_reader(page)


def test_a_fail_is_said_in_words(plain: Browser, address: str, tmp_path: Path) -> None:
    none = tmp_path / "none.mp4"
    none.write_bytes(b"no film at all")
    with quiet_page(plain, f"{address}receive") as page:
        page.set_input_files("#film", none)
        expect(page.locator(".notice.bad")).to_be_visible()


@pytest.mark.parametrize("page_name", ["", "transmit", "receive"])
def test_a_screen_reader_finds_its_way(plain: Browser, address: str, page_name: str) -> None:
    with quiet_page(plain, address + page_name, viewport={"width": 390, "height": 800}) as page:
        for details in page.locator("details").all():
            details.evaluate("one => { one.open = true; }")
        if page_name == "transmit":
            transmitting(page)
        elif page_name == "receive":
            page.evaluate("() => { document.getElementById('why').hidden = false; }")
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            sound_to_a_reader(page)
        wide = page.evaluate("document.documentElement.scrollWidth")
        assert wide <= 390
