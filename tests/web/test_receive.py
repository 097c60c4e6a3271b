import json
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import called
from fastapi.testclient import TestClient
from screen_films import Grabs, Phone, phone_frames, write_phone_film
from screen_light import shown
from starlette.testclient import WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from heliograph.base.frames import Frame
from heliograph.link.truth import signal_of
from heliograph.media import open_film
from heliograph.probe.screens import cells_of_a_side, patterns_per_s, usual
from heliograph.receive import Packet
from heliograph.receive.screen.receiver import ScreenReceiver
from heliograph.signal.settings import SignalSettings
from heliograph.web.app import create_app
from heliograph.web.camera_frames import HEAD, MAX_WAITING, CameraFrames, MessageError
from heliograph.web.sending import screen_settings, sending_of

OWN = "http://127.0.0.1:8000"
SOCKET = "ws://127.0.0.1:8000/api/receive"
TEXT = "18 °C am Bildschirm"
SMALL = Phone(width=240, height=240, side_px=200, blur_px=0.8, seed=5)


def grabs(side: int = 16, rate_hz: float = 15.0, seconds: float = 5.0) -> Grabs:
    return shown(sending_of(TEXT.encode(), None, side, rate_hz), seconds, cell_px=8)


@pytest.fixture
def client() -> Iterator[TestClient]:
    with TestClient(create_app(), base_url=OWN) as made:
        yield made


def said(client: TestClient, wish: dict[str, Any], messages: list[bytes | str] = ()) -> list[dict[str, Any]]:  # type: ignore[assignment]
    """Send messages; return all rows until the server closes."""
    with client.websocket_connect(SOCKET, ["heliograph"]) as socket:
        socket.send_text(json.dumps(wish))
        for message in messages:
            socket.send_bytes(message) if isinstance(message, bytes) else socket.send_text(message)
        return to_the_end(socket)


def to_the_end(socket: WebSocketTestSession) -> list[dict[str, Any]]:
    """Return rows until the server closes; an earlier disconnection would end the server's task within a worker."""
    rows = []
    while True:
        try:
            rows.append(socket.receive_json())
        except WebSocketDisconnect:
            return rows


def message(time_s: float, pixels: np.ndarray[Any, np.dtype[np.uint8]], number: int = 0) -> bytes:
    return HEAD.pack(time_s, number, pixels.shape[1], pixels.shape[0]) + pixels.tobytes()


@pytest.mark.slow
def test_a_film_is_read_without_being_told_of_its_light(client: TestClient, tmp_path: Path) -> None:
    film = tmp_path / "phone.mp4"
    write_phone_film(film, phone_frames(grabs(side=12), SMALL), SMALL)
    name = client.put("/api/films?kind=mp4", content=film.read_bytes()).json()["film"]
    rows = said(client, {"kind": "film", "film": name})
    assert {row["text"] for row in rows if row["event"] == "message"} == {TEXT}
    assert {"event": "light", "rate_hz": 15.0, "side": 12} in rows
    assert rows[-1]["event"] == "end"
    assert rows[-1]["ok"] > 0


@pytest.mark.slow
def test_a_camera_is_read_as_it_films(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CameraFrames.end, "__defaults__", (600.0,))  # independent of machine load
    frames = [message(time_s, pixels, k) for k, (time_s, pixels) in enumerate(phone_frames(grabs(), SMALL))]
    rows: list[dict[str, Any]] = []
    with client.websocket_connect(SOCKET, ["heliograph"]) as socket:
        socket.send_text(json.dumps({"kind": "camera"}))
        sent = taken = 0
        while not rows or rows[-1]["event"] != "end":
            while sent < len(frames) and sent - taken < MAX_WAITING:
                socket.send_bytes(frames[sent])
                sent += 1
                if sent == len(frames):
                    socket.send_text("end")
            rows.append(socket.receive_json())
            taken = rows[-1]["frames"] if rows[-1]["event"] == "took" else taken
        assert not to_the_end(socket)
    assert {row["text"] for row in rows if row["event"] == "message"} == {TEXT}
    assert rows[-2]["dropped"] == 0 if rows[-2]["event"] == "took" else True


def opened_again(client: TestClient, row: dict[str, Any], path: Path) -> tuple[SignalSettings, int]:
    """Download a saved film by the name in the row; return signal settings and frame count."""
    answer = client.get(f"/api/bundles/{row['bundle']}")
    assert len(answer.content) == row["bytes"]
    path.write_bytes(answer.content)
    with open_film(path) as read:
        return signal_of(read, screen_settings(8, 1.0).signal, ())[0], len(list(read))


@pytest.mark.slow
def test_where_nothing_is_read_it_is_said_why_and_the_frames_are_saved(client: TestClient, tmp_path: Path) -> None:
    noise, told = np.random.default_rng(1), list[dict[str, Any]]()
    with client.websocket_connect(SOCKET, ["heliograph"]) as socket:
        socket.send_text(json.dumps({"kind": "camera", "side": 20}))
        socket.send_text("save")
        assert socket.receive_json() == {"event": "refused", "error": "the camera has sent no frames: start the camera"}
        for k in range(300):
            socket.send_bytes(message(k / 20, noise.integers(90, 110, (64, 64), np.uint8), k))
            while (row := socket.receive_json())["event"] != "took":
                told.append(row)
        socket.send_text("save")
        while (row := socket.receive_json())["event"] != "saved":
            pass
        socket.send_text("end")
        rest = to_the_end(socket)
    signal, frames = opened_again(client, row, tmp_path / "failed.h5")
    assert signal == screen_settings(20, 10.0).signal
    assert frames > 2 * signal.packet_s * 20
    assert next(row for row in told if row["event"] == "why")["lines"]
    assert [one["event"] for one in rest[-2:]] == ["bundle", "end"]


@pytest.mark.slow
def test_what_failed_of_a_film_is_offered_and_read_again_by_the_command(
    client: TestClient, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    film, blurred = tmp_path / "phone.mp4", replace(SMALL, blur_px=6.5)
    write_phone_film(film, phone_frames(grabs(), blurred), blurred)
    name = client.put("/api/films?kind=mp4", content=film.read_bytes()).json()["film"]
    rows = said(client, {"kind": "film", "film": name})
    assert rows[-1]["event"] == "end"
    assert rows[-1]["failed"] > 0
    signal, frames = opened_again(client, rows[-2], tmp_path / "failed.h5")
    assert signal == screen_settings(16, 15.0).signal
    assert frames > 60
    called("receive", tmp_path / "failed.h5", "--preset", "phone", "--output", tmp_path / "got",
           capfd=capfd, monkeypatch=monkeypatch)  # fmt: skip
    again = json.loads((tmp_path / "got" / "summary.json").read_text())
    assert sum(layer["failed"] for array in again["arrays"] for layer in array["layers"].values()) > 0
    assert client.put("/api/films", content=b"x").status_code == 201
    assert len(client.app.state.shared.uploads._films) == 1  # type: ignore[attr-defined]  # the one that was read is gone


@pytest.mark.slow
def test_a_camera_that_is_stopped_ends_in_time_though_it_is_read_slowly(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(CameraFrames.end, "__defaults__", (1.0,))
    push = ScreenReceiver.push

    def slow(self: ScreenReceiver, frame: Frame) -> Iterator[Packet]:
        time.sleep(0.1)
        return push(self, frame)

    monkeypatch.setattr(ScreenReceiver, "push", slow)
    frames = [message(time_s, pixels, k) for k, (time_s, pixels) in enumerate(phone_frames(grabs(seconds=9.0), SMALL))]
    with client.websocket_connect(SOCKET, ["heliograph"]) as socket:
        socket.send_text(json.dumps({"kind": "camera", "side": 16, "rate_hz": 15.0}))
        taken = 0
        for sent, one in enumerate(frames[:230], 1):
            socket.send_bytes(one)
            while sent - taken >= 80:
                row = socket.receive_json()
                taken = row["frames"] if row["event"] == "took" else taken
        socket.send_text("end")
        rows = to_the_end(socket)
    assert rows[-1]["event"] == "end"
    assert rows[-1]["frames"] < 40
    left = [row["frames"] for row in rows if row["event"] == "left"]
    assert left == sorted(left, reverse=True)
    assert left[0] > 150


def test_why_is_told_of_a_film_without_patterns(client: TestClient, tmp_path: Path) -> None:
    film = tmp_path / "still.mp4"
    write_phone_film(film, [(k / 30, np.full((64, 64), 90, np.uint8)) for k in range(60)], Phone(width=64, height=64))
    name = client.put("/api/films?kind=mp4", content=film.read_bytes()).json()["film"]
    rows = said(client, {"kind": "film", "film": name})
    assert next(row["lines"] for row in rows if row["event"] == "why")
    assert rows[-1]["ok"] == 0


@pytest.mark.parametrize(
    "wish",
    [
        {},
        {"kind": "film", "film": "../../etc/passwd"},
        {"kind": "film", "film": "x" * 65},
        {"kind": "camera", "side": 10},
        {"kind": "camera", "rate_hz": -1},
        {"kind": "camera", "more": 1},
        {"kind": "drive"},
    ],
)
def test_wishes_that_are_none_end_in_words(client: TestClient, wish: dict[str, Any]) -> None:
    rows = said(client, wish)
    assert [row["event"] for row in rows] == ["error"]
    assert client.app.state.shared.sessions.taken == 0  # type: ignore[attr-defined]


def test_a_film_that_is_none_ends_in_words(client: TestClient) -> None:
    name = client.put("/api/films", content=b"no film at all").json()["film"]
    (error,) = [row["error"] for row in said(client, {"kind": "film", "film": name}) if row["event"] == "error"]
    assert "the film" in error
    assert "/" not in error


@pytest.mark.parametrize(
    "bad",
    [
        b"",
        b"short",
        HEAD.pack(1.0, 0, 64, 64),
        HEAD.pack(1.0, 0, 8, 8) + bytes(64),
        HEAD.pack(1.0, 0, 65535, 65535) + bytes(100),
        HEAD.pack(float("nan"), 0, 64, 64) + bytes(4096),
        HEAD.pack(-1.0, 0, 64, 64) + bytes(4096),
        "halt",
    ],
)
def test_frames_that_are_none_let_a_page_go(client: TestClient, bad: bytes | str) -> None:
    rows = said(client, {"kind": "camera"}, [bad])
    assert rows[-1]["event"] == "error"


def test_frames_come_in_order_and_of_one_size() -> None:
    camera = CameraFrames()
    camera.put(message(1.0, np.zeros((64, 64), np.uint8)))
    with pytest.raises(MessageError, match="increase"):
        camera.put(message(1.0, np.zeros((64, 64), np.uint8)))
    with pytest.raises(MessageError, match="same size"):
        camera.put(message(2.0, np.zeros((64, 32), np.uint8)))


def test_frames_that_find_no_place_are_dropped_and_counted() -> None:
    camera = CameraFrames()
    for k in range(MAX_WAITING + 5):
        camera.put(message(float(k), np.zeros((64, 64), np.uint8), k))
    camera.end()
    assert camera.dropped == 5
    assert [frame.index for frame in camera] == list(range(MAX_WAITING))


def test_a_film_of_what_failed_that_is_not_there_is_said_so(client: TestClient) -> None:
    assert client.get("/api/bundles/nothing").status_code == 404


@pytest.mark.slow
@pytest.mark.parametrize(
    ("side", "rate_hz", "fps"), [(8, 10.0, 30.0), (20, 15.0, 30.0), (32, 30.0, 60.0), (16, 1.0, 30.0)]
)
def test_rate_and_cells_are_found(side: int, rate_hz: float, fps: float) -> None:
    phone = Phone(fps=fps, width=320, height=320, side_px=280, blur_px=0.8, seed=side)
    seen = phone_frames(grabs(side, rate_hz, 4.0 if rate_hz > 5 else 7.0), phone)
    frames = [Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(seen)]
    assert patterns_per_s(frames) == pytest.approx(rate_hz)
    assert cells_of_a_side(frames) == side


def test_nothing_is_found_in_noise() -> None:
    noise = np.random.default_rng(2)
    frames = [Frame(k, k / 30, noise.integers(80, 120, (120, 160), np.uint8)) for k in range(64)]
    assert patterns_per_s(frames) is None
    assert cells_of_a_side(frames) is None


@pytest.mark.parametrize(("measured", "meant"), [(10.04, 10.0), (14.43, 14.4), (1.99, 2.0), (13.0, 13.0)])
def test_rates_are_taken_for_those_of_displays(measured: float, meant: float) -> None:
    assert usual(measured) == pytest.approx(meant)
