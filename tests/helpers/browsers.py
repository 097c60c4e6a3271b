"""Headless browsers for page tests."""

import base64
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, BrowserType, Page, expect
from screen_films import Grabs
from waiting import HANG_MS

CHROMIUM = next((found for name in ("chromium", "chromium-browser") if (found := shutil.which(name))), None)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="chromium is not installed: apt-get install chromium")

expect.set_options(timeout=HANG_MS)

SWITCHES = (
    "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--no-first-run", "--autoplay-policy=no-user-gesture-required",
)  # fmt: skip
DISPLAY = """
let asked = [], now = 0;
window.requestAnimationFrame = (draw) => asked.push(draw);
window.refresh = () => { now += 1000 / 60; asked.splice(0).forEach((draw) => draw(now)); };
"""
"""A script of a page: a display of 60 Hz that is refreshed by `refresh()`, so that a busy machine skips nothing."""
GRABBED = """
async ([refreshes, size]) => {
  const canvas = document.getElementById("array");
  const small = new OffscreenCanvas(size, size).getContext("2d", { willReadFrequently: true, alpha: false });
  const times = [], pictures = [];
  let last = new Uint8Array(size * size);
  for (let k = 0; k < refreshes; k += 1) {
    refresh();
    small.drawImage(canvas, 0, 0, size, size);
    const pixels = small.getImageData(0, 0, size, size).data;
    const gray = Uint8Array.from({ length: size * size }, (_, k) => pixels[4 * k + 1]);
    if (gray.some((level, k) => level !== last[k])) {
      times.push(k / 60);
      pictures.push(gray);
      last = gray;
    }
  }
  const all = new Blob(pictures);
  const read = new FileReader();
  await new Promise((done) => { read.onload = done; read.readAsDataURL(all); });
  return [times, read.result.split(",")[1]];
}
"""
"""Refresh the display and keep changed images of the canvas."""

SMALL_TARGETS = """
    () => [...document.querySelectorAll("button, summary, select, input")]
      .map((target) => [target.outerHTML.slice(0, 60), target.getBoundingClientRect()])
      .filter(([_, box]) => box.width > 0 && (box.width < 24 || box.height < 24))
      .map(([text]) => text)
"""
"""Controls below 24 px (WCAG 2.2, 2.5.8)."""


@contextmanager
def browser(kind: BrowserType, *switches: str) -> Iterator[Browser]:
    found = kind.launch(executable_path=CHROMIUM, headless=True, args=[*SWITCHES, *switches])
    try:
        yield found
    finally:
        found.close()


@contextmanager
def quiet_page(found: Browser, address: str, script: str = "", **options: object) -> Iterator[Page]:
    """Yield a page after running a script; fail on console messages."""
    page = found.new_page(**options)  # type: ignore[arg-type]
    page.add_init_script(script)
    page.set_default_timeout(HANG_MS)
    complaints: list[str] = []
    page.on("console", lambda said: complaints.append(said.text) if said.type in ("error", "warning") else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(address)
    try:
        yield page
    finally:
        page.close()
    assert not complaints


def webcam_of(path: Path) -> Sequence[str]:
    """Return switches that make an MJPEG file the browser's webcam and grant camera permission."""
    fakes = ("--use-fake-device-for-media-stream", "--use-fake-ui-for-media-stream")
    return (*fakes, f"--use-file-for-fake-video-capture={path}")


def grabbed(page: Page, seconds: float, size: int = 240) -> Grabs:
    """Grab the canvas on page *Transmit* for some seconds of the display."""
    times, data = page.evaluate(GRABBED, [round(60 * seconds), size])
    pictures = np.frombuffer(base64.b64decode(data), np.uint8).reshape(-1, size, size)
    return Grabs(np.array([*times, seconds]), np.concatenate([pictures, pictures[-1:]]))


def check_accessibility(page: Page) -> None:
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-playwright-python is not installed")
    found = axe.Axe().run(page)
    assert found.violations_count == 0, found.generate_report()
