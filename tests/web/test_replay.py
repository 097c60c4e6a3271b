"""Page for replay: a run in a file, played by a browser without a server."""

import json
import re
import subprocess
import sys
from base64 import b64encode
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("playwright", reason="playwright is not installed: pip install playwright")

from browsers import check_accessibility, needs_chromium, quiet_page
from cli_runs import failed, lasting, succeeded, within
from playwright.sync_api import Browser, expect
from web_server import serving

from heliograph.base.frames import Frame
from heliograph.measure.reception import ReceptionCounter
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings
from heliograph.web.replay import MAX_BYTES, ReplayLog


def entries(page: str) -> list[dict[str, object]]:
    found = re.search(r'id="run">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    run: list[dict[str, object]] = json.loads(found[1])
    return run


@pytest.mark.slow
def test_page_of_a_long_run_has_a_bounded_size_and_frames_of_all_of_it() -> None:
    log = ReplayLog(SignalSettings(), ReceiveSettings(), ReceptionCounter(None))
    noise = np.random.default_rng(1).integers(0, 255, (480, 640), np.uint8)
    for k in range(400):
        log.frame(Frame(k, k / 50, noise))
        log.tell({"event": "message", "id": 0, "text": f"</script> {k}"})
    page = log.page()
    assert 0.4 * MAX_BYTES < len(page) < 15e6
    rows = entries(page)
    assert [row["text"] for row in rows if row.get("event") == "message"] == [f"</script> {k}" for k in range(400)]
    places = [k for k, row in enumerate(rows) if "scene" in row]
    assert places[0] < 10
    assert places[-1] >= len(rows) - 3
    gaps = np.diff([k - places.index(k) for k in places])  # thinned out evenly, by powers of two
    assert gaps[:-2].max() <= 4 * max(gaps[:-2].min(), 1)


@pytest.mark.slow
def test_replay_and_commands_need_no_extra() -> None:
    absent = ("fastapi", "starlette", "uvicorn", "websockets", "segno", "rerun", "xarray", "dask")
    code = f"import sys; sys.modules.update(dict.fromkeys({absent})); import heliograph.cli.main, heliograph.web.replay"
    subprocess.run([sys.executable, "-c", code], check=True)


@needs_chromium
@pytest.mark.slow
def test_run_plays_in_a_browser_without_a_server(tmp_path: Path, chromium: Browser) -> None:
    succeeded(within(tmp_path, "simulate", "a.mkv", *lasting(0.3), "--high", "text:red for 12 s", "--low", "text:left"))
    assert "cannot write" in failed(within(tmp_path, "receive", "a.mkv", "--replay", "missing/run.html"))
    succeeded(within(tmp_path, "receive", "a.mkv", "--truth", "a.mkv.truth.npz", "--replay", "run.html"))
    with quiet_page(chromium, (tmp_path / "run.html").as_uri()) as page:
        where = page.locator("#where")
        expect(where).to_contain_text("0.000 s")
        expect(page.locator("#source-box")).to_be_hidden()
        page.get_by_role("button", name="Next packet").click()
        expect(page.locator("#messages")).to_contain_text("red for 12 s")
        page.get_by_role("button", name="Take the tour").click()
        expect(page.locator("#tour-title")).to_have_text("1 of 5: Pattern and inverse")
        check_accessibility(page)
        page.get_by_role("button", name="End tour").click()
        page.get_by_role("button", name="Play").click()
        expect(where).to_contain_text("0.299 s")


@needs_chromium
@pytest.mark.slow
def test_caption_names_the_first_completion_of_a_picture(tmp_path: Path, chromium: Browser) -> None:
    log = ReplayLog(SignalSettings(), ReceiveSettings(), ReceptionCounter(None))
    for k, level in enumerate((90, 160, 90)):  # the third picture is the first one again
        picture = cv2.imencode(".png", np.full((8, 8), level, np.uint8))[1].tobytes()
        log.frame(Frame(k, float(k), np.zeros((48, 64), np.uint8)))
        packet = {"event": "packet", "id": 0, "time_s": float(k), "status": "ok", "distance_m": 60.0 - 10 * k}
        log.tell({**packet, "approach_m_s": None, "layers": {}})
        message = {"event": "message", "id": 0, "layer": "low", "stream": 0, "bytes": len(picture)}
        log.tell({**message, "data": b64encode(picture).decode()})
    (tmp_path / "run.html").write_text(log.page(), encoding="utf-8")
    with quiet_page(chromium, (tmp_path / "run.html").as_uri()) as page:
        caption, step = page.locator("#picture figcaption"), page.get_by_role("button", name="Next frame")
        expect(caption).to_contain_text("complete at 0.00 s, 60 m away: picture 1, ")
        step.click()
        expect(caption).to_contain_text("complete at 1.00 s, 50 m away: picture 2, ")
        step.click()
        expect(caption).to_contain_text("complete at 0.00 s, 60 m away: picture 1, ")


@needs_chromium
@pytest.mark.slow
def test_first_page_leads_to_the_recorded_drive(chromium: Browser) -> None:
    with serving() as url, quiet_page(chromium, url) as page:
        expect(page.locator("picture img")).to_be_visible()
        check_accessibility(page)
        page.get_by_role("link", name="Replay").click()
        page.get_by_role("button", name="Take the tour").click()
        for _ in range(4):
            page.get_by_role("button", name="Next", exact=True).click()
        expect(page.locator("#tour-title")).to_have_text("5 of 5: What arrived")
        expect(page.locator("#messages")).to_contain_text("red for 12 s")
        expect(page.locator("#bits .point.open")).to_have_count(1)  # the low layer of the first packet
