"""A text goes from page *Transmit* over a phone's film to page *Receive*, in a real browser."""

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("playwright", reason="playwright is not installed: pip install playwright")

from browsers import browser, grabbed, needs_chromium, quiet_page, served
from cli_runs import heliograph
from screen_films import Phone, phone_frames, write_phone_film, write_webcam

pytestmark = [pytest.mark.slow, needs_chromium]

TEXT = "Grüße vom Bildschirm: 18 °C, 42 % ☀"
PHONE = Phone(seed=3)


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with served() as url:
        yield url


@pytest.fixture(scope="module")
def films(address: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("screen")
    with browser() as found, quiet_page(found, f"{address}transmit") as page:
        page.wait_for_selector("#rate option", state="attached")
        page.fill("#text", TEXT)
        page.select_option("#rate", label="15")
        page.click("#send")
        page.wait_for_selector("#pause:enabled")
        frames = list(phone_frames(grabbed(page, 7.0), PHONE))
    film, webcam = folder / "phone.mp4", folder / "phone.mjpeg"
    write_phone_film(film, frames, PHONE)
    write_webcam(webcam, frames)
    return film, webcam


def test_the_command_reads_what_a_phone_films_of_the_page(films: tuple[Path, Path], tmp_path: Path) -> None:
    got = heliograph("receive", films[0], "--preset", "phone-15", "--output", tmp_path, cwd=tmp_path)
    assert got.returncode == 0, got.stderr
    assert (tmp_path / "array-0-high-0.bin").read_bytes() == TEXT.encode()
