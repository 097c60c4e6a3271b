"""Reception of films and browser cameras by page *Receive*."""

import contextlib
import functools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import within
from fastapi.testclient import TestClient
from screen_films import Grabs, Gray, Phone, phone_frames, screen_corners, write_phone_film
from screen_light import shown
from starlette.testclient import WebSocketTestSession
from starlette.websockets import WebSocketDisconnect

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.link.truth import signal_of
from heliograph.media import open_film
from heliograph.probe.screens import cells_of_a_side, patterns_per_s, usual
from heliograph.receive.packet import Packet
from heliograph.receive.screen.receiver import ScreenReceiver
from heliograph.signal.settings import SignalSettings
from heliograph.web.camera_frames import HEAD, MAX_WAITING, CameraFrames
from heliograph.web.crashes import GoneError
from heliograph.web.failures import FailureRecorder
from heliograph.web.link_estimate import LinkRequest
from heliograph.web.outline import OutlineFinder
from heliograph.web.reading import PageReader
from heliograph.web.sending import screen_settings, sending_of
from heliograph.web.stores import Store, StoredFilm

pytestmark = pytest.mark.usefixtures("quick_ends")
Timed = list[tuple[float, Gray]]
SOCKET = "ws://127.0.0.1:8000/api/receive"
TEXT = "18 °C am Bildschirm"
SMALL = Phone(width=240, height=240, side_px=200, blur_px=0.8, seed=5)


def grabs(side: int = 16, rate_hz: float = 15.0, seconds: float = 5.0, inverses: bool = True) -> Grabs:
    return shown(sending_of(TEXT.encode(), None, side, rate_hz, inverses), seconds, cell_px=8)


@pytest.fixture(scope="module")
def sharp_frames() -> Timed:
    """A phone's frames of a text with 16 x 16 cells at 15 patterns/s."""
    return list(phone_frames(grabs(), SMALL))


def rows_of(client: TestClient, request: dict[str, Any], messages: Sequence[bytes | str] = ()) -> list[dict[str, Any]]:
    """Send messages; return all rows until the server closes."""
    with client.websocket_connect(SOCKET, ["heliograph"]) as socket:
        socket.send_text(json.dumps(request))
        for message in messages:
            socket.send_bytes(message) if isinstance(message, bytes) else socket.send_text(message)
        return to_the_end(socket)


def rows_of_film(client: TestClient, path: Path, frames: Iterable[Any], phone: Phone, **link: float) -> Any:
    write_phone_film(path, frames, phone)
    name = client.put("/api/films?kind=mp4", content=path.read_bytes()).json()["film"]
    return rows_of(client, {"kind": "film", "film": name, **link})


def to_the_end(socket: WebSocketTestSession) -> list[dict[str, Any]]:
    """Return rows until the server closes; an earlier disconnection would end the server's task within a worker."""
    rows = []
    with contextlib.suppress(WebSocketDisconnect):
        while True:
            rows.append(socket.receive_json())
    return rows


def message(time_s: float, pixels: np.ndarray[Any, np.dtype[np.uint8]], number: int = 0) -> bytes:
    return HEAD.pack(time_s, number, pixels.shape[1], pixels.shape[0]) + pixels.tobytes()


@pytest.mark.slow
@pytest.mark.parametrize("inverses", [True, False])
def test_film_needs_no_settings(client: TestClient, tmp_path: Path, inverses: bool) -> None:
    phone = replace(SMALL, seed=6 - inverses)
    rows = rows_of_film(client, tmp_path / "phone.mp4", phone_frames(grabs(inverses=inverses), phone), phone)
    assert {row["text"] for row in rows if row["event"] == "message"} == {TEXT}
    assert {"event": "light", "rate_hz": 15.0, "side": 16} in rows
    assert (rows[-1]["event"], rows[-1]["ok"] > 0) == ("end", True)


@pytest.mark.slow
def test_camera_is_received_while_filming(
    client: TestClient, sharp_frames: Timed, monkeypatch: pytest.MonkeyPatch
) -> None:
    # independent of machine load
    monkeypatch.setattr("heliograph.web.receive.CameraFrames", functools.partial(CameraFrames, 600.0))
    frames = [message(time_s, pixels, k) for k, (time_s, pixels) in enumerate(sharp_frames)]
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
    assert {row["dropped"] for row in rows if row["event"] == "took"} == {0}


def opened_again(client: TestClient, row: dict[str, Any], path: Path) -> tuple[SignalSettings, int]:
    """Download a saved film by the name in the row; return signal settings and frame count."""
    answer = client.get(f"/api/bundles/{row['bundle']}")
    assert len(answer.content) == row["bytes"]
    path.write_bytes(answer.content)
    with open_film(path) as read:
        return signal_of(read, screen_settings(8, 1.0).signal, ())[0], len(list(read))


@pytest.mark.slow
def test_diagnosis_and_film_follow_a_camera_without_packets(client: TestClient, tmp_path: Path) -> None:
    noise, told = np.random.default_rng(1), list[dict[str, Any]]()
    with client.websocket_connect(SOCKET, ["heliograph"]) as socket:
        socket.send_text(json.dumps({"kind": "camera", "side": 20}))
        socket.send_text("save")
        assert socket.receive_json() == {"event": "refused", "error": "the reception has no frames yet"}
        for k in range(140):
            socket.send_bytes(message(k / 10, noise.integers(90, 110, (64, 64), np.uint8), k))
            while (row := socket.receive_json())["event"] != "took":
                told.append(row)
        socket.send_text("save")
        while (row := socket.receive_json())["event"] != "saved":
            pass
        socket.send_text("end")
        rest = to_the_end(socket)
    signal, frames = opened_again(client, row, tmp_path / "failed.h5")
    assert signal == screen_settings(20, 10.0).signal
    assert frames > 2 * signal.packet_s * 10
    why = next(row for row in told if row["event"] == "why")
    assert why["lines"]
    assert [row["event"] for row in told].count("early") == 1
    assert 0 < why["bytes"] < 50_000_000
    assert [row["event"] for row in rest[-2:]] == ["bundle", "end"]


@pytest.mark.slow
def test_failed_packets_of_a_film_are_received_again_by_the_command(client: TestClient, tmp_path: Path) -> None:
    blurred = replace(SMALL, blur_px=6.5)
    rows = rows_of_film(client, tmp_path / "phone.mp4", phone_frames(grabs(), blurred), blurred, side=16, rate_hz=15)
    assert (rows[-1]["event"], rows[-1]["failed"] > 0) == ("end", True)
    assert not client.app.state.shared.uploads.items()  # type: ignore[attr-defined]  # the film is deleted
    signal, frames = opened_again(client, rows[-2], tmp_path / "failed.h5")
    assert signal == screen_settings(16, 15.0).signal
    assert frames > 60
    within(tmp_path, "receive", "failed.h5", "--preset", "phone", "--output", "got")
    again = json.loads((tmp_path / "got" / "summary.json").read_text())
    assert sum(layer["failed"] for array in again["arrays"] for layer in array["layers"].values()) > 0


Rows = list[Mapping[str, Any]]


def read_camera(camera: CameraFrames, rows: Rows, folder: Path) -> None:
    camera.end()
    request = LinkRequest(side=16, rate_hz=None)
    recorder = FailureRecorder(folder, request.default_link.signal)
    PageReader(request, rows.append, recorder, Store(1, "", StoredFilm.drop)).read_camera(camera)


def test_frames_of_stopped_cameras_are_left_after_the_deadline(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    camera, rows = CameraFrames(), Rows()
    for k in range(90):
        camera.put(message(k / 20, np.full((64, 64), 90 + k % 2, np.uint8), k))
    push, pushed = ScreenReceiver.push, list[Frame]()

    def push_until_deadline(self: ScreenReceiver, frame: Frame) -> Iterator[Packet]:
        pushed.append(frame)
        if len(pushed) == 10:
            camera.end(-1.0)  # the deadline has passed
        return push(self, frame)

    monkeypatch.setattr(ScreenReceiver, "push", push_until_deadline)
    read_camera(camera, rows, tmp_path)
    assert (len(pushed), next(row["frames"] for row in rows if row["event"] == "left")) == (10, 89)
    assert (rows[-1]["event"], rows[-1]["frames"]) == ("end", 10)


def test_single_frame_after_a_gap_is_diagnosed(tmp_path: Path) -> None:
    camera, rows = CameraFrames(), Rows()
    for time_s, number in ((0.0, 0), (0.1, 1), (13.0, 400)):
        camera.put(message(time_s, np.full((64, 64), 90, np.uint8), number))
    with pytest.raises(MediaError, match="frame"):  # too few frames for a packet
        read_camera(camera, rows, tmp_path)
    assert "why" in {row["event"] for row in rows}


@pytest.mark.slow
def test_likely_reason_comes_first(client: TestClient, tmp_path: Path, sharp_frames: Timed) -> None:
    burnt = replace(SMALL, gain=8.0)
    rows = rows_of_film(client, tmp_path / "burnt.mp4", phone_frames(grabs(), burnt), burnt, side=16)
    assert (rows[0]["event"], rows[0]["lines"][0][:9]) == ("early", "Exposure:")
    assert next(row["lines"] for row in rows[1:] if row["event"] == "why")
    rows = rows_of_film(client, tmp_path / "sharp.mp4", sharp_frames, SMALL)
    assert (rows[0], [row["event"] for row in rows].count("early")) == ({"event": "early", "lines": []}, 1)


@pytest.mark.parametrize(
    ("phone", "rate_hz", "reason"),
    [
        (replace(SMALL, gain=0.005, noise=0.5), 15.0, "Exposure: the patterns are dark"),
        (replace(SMALL, gain=8.0), 15.0, "Exposure: 74 % of the patterns are white blots"),
        (replace(SMALL, blur_px=6.5), 15.0, "Focus:"),
        (replace(SMALL, side_px=0.1), 15.0, "Sight: no area changes"),
        (SMALL, 15.0, ""),
        (replace(SMALL, gain=5.0, seed=8), 2.0, "Exposure: 58 % of the patterns are white blots"),
        (replace(SMALL, seed=13), 2.0, ""),
        (replace(SMALL, seed=9), 1.0, ""),
    ],
    ids=["dark", "burnt", "blurred", "no screen", "none", "burnt and slow", "slow", "header only"],
)
def test_likely_reason_of_a_camera_comes_within_five_seconds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, phone: Phone, rate_hz: float, reason: str
) -> None:
    monkeypatch.setattr("heliograph.web.camera_frames.MAX_WAITING", 1000)
    camera = CameraFrames()
    frames = list(phone_frames(grabs(rate_hz=rate_hz), phone))
    for k, (time_s, pixels) in enumerate(frames):
        camera.put(message(1 + time_s, pixels, k))
    rows = rows_before(camera, ("early",), tmp_path)
    assert rows[-1]["event"] == "early"
    assert [line[: len(reason)] for line in rows[-1]["lines"]] == [reason] * bool(reason)
    assert frames[[row["event"] for row in rows].count("took")][0] < 5.0


def rows_before(camera: CameraFrames, events: Sequence[str], folder: Path) -> Rows:
    """Read a camera; return the rows up to the first one with an event."""
    rows = Rows()

    def tell(row: Mapping[str, Any]) -> None:
        rows.append(row)
        if row["event"] in events:
            raise GoneError  # ends the reception

    request = LinkRequest()
    recorder = FailureRecorder(folder, request.default_link.signal)
    with contextlib.suppress(GoneError):
        PageReader(request, tell, recorder, Store(1, "", StoredFilm.drop)).read_camera(camera)
    return rows


@pytest.mark.slow
def test_packet_of_slow_patterns_has_time_to_arrive(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.camera_frames.MAX_WAITING", 1000)
    slow = replace(SMALL, fps=8.0, width=160, height=160, side_px=130.0, seed=7)
    camera = CameraFrames()
    # a packet lasts 15 s: the first one has begun, and the second one ends after 24 s
    for k, (time_s, pixels) in enumerate(phone_frames(grabs(rate_hz=2.0, seconds=46.0), slow)):
        if time_s > 6.0:
            camera.put(message(time_s, pixels, k))
    rows = rows_before(camera, ("message", "why"), tmp_path)
    assert rows[-1]["event"] == "message"


@pytest.mark.parametrize("side_px", [60, 120, 200])
def test_outline_of_a_screen_is_found_within_a_second(side_px: float) -> None:
    phone = replace(SMALL, side_px=side_px)
    finder, found = OutlineFinder(), list[tuple[float, list[float]]]()
    for k, (time_s, pixels) in enumerate(phone_frames(grabs(seconds=2.0), phone)):
        corners = finder.add(Frame(k, time_s, pixels))
        if corners:
            found.append((time_s, corners))
    assert found[0][0] <= 1.0
    # the array has 16 of 20 cells of the picture, and the camera shakes
    cells = np.array([(2, 2), (18, 2), (18, 18), (2, 18)]) / 20
    (a, b, c, d), (x, y) = screen_corners(phone, np.random.default_rng(phone.seed)), np.split(cells, 2, axis=1)
    true = (a * (1 - x) + b * x) * (1 - y) + (d * (1 - x) + c * x) * y
    for _, corners in found:
        assert np.abs(np.reshape(corners, (4, 2)) * (phone.width, phone.height) - true).max() < 0.08 * side_px


def outlines(pictures: Iterable[Gray]) -> list[list[float]]:
    """Return the results of a search in pictures at 30 frames/s."""
    finder = OutlineFinder()
    found = [finder.add(Frame(k, k / 30, picture)) for k, picture in enumerate(pictures)]
    return [corners for corners in found if corners is not None]


@pytest.mark.parametrize("deviation", [0.0, 3.0])
def test_noise_and_a_still_picture_have_no_outline(deviation: float) -> None:
    noise = np.random.default_rng(3)
    seen = outlines(np.rint(noise.normal(90, deviation, (120, 160))).astype(np.uint8) for _ in range(60))
    assert seen
    assert not any(seen)


def test_a_shaking_picture_has_rarely_an_outline() -> None:
    noise, picture = np.random.default_rng(1), np.full((340, 340), 120, np.uint8)
    for x, y, width, height, level in noise.integers((0, 0, 10, 10, 20), (320, 320, 100, 100, 230), (60, 5)).tolist():
        picture[y : y + height, x : x + width] = level
    k = np.arange(150)
    ways = np.rint(20 + 4 * np.sin((k / 6, k / 7.5)) + 2 * np.sin((k / 2.7, k / 3.3))).astype(int).T
    seen = outlines(np.ascontiguousarray(picture[y : y + 300, x : x + 300]) for x, y in ways)
    assert len(seen) > 12
    assert sum(map(bool, seen)) <= len(seen) // 10


REQUESTS = [
    {}, {"kind": "film", "film": "../../etc/passwd"}, {"kind": "film", "film": "x" * 65},
    {"kind": "camera", "side": 10}, {"kind": "camera", "rate_hz": -1}, {"kind": "camera", "more": 1}, {"kind": "drive"},
]  # fmt: skip
FRAMES = [
    b"", b"short", HEAD.pack(1.0, 0, 64, 64), HEAD.pack(1.0, 0, 8, 8) + bytes(64),
    HEAD.pack(1.0, 0, 65535, 65535) + bytes(100), HEAD.pack(float("nan"), 0, 64, 64) + bytes(4096),
    HEAD.pack(-1.0, 0, 64, 64) + bytes(4096), "halt",
]  # fmt: skip


@pytest.mark.parametrize(
    ("request_", "bad"), [*((request, None) for request in REQUESTS), *(({"kind": "camera"}, bad) for bad in FRAMES)]
)
def test_invalid_requests_and_frames_end_the_connection_with_an_error(
    client: TestClient, request_: dict[str, Any], bad: bytes | str | None
) -> None:
    rows = rows_of(client, request_, [] if bad is None else [bad])
    assert [row["event"] for row in rows] == ["error"]
    assert client.app.state.shared.sessions.taken == 0  # type: ignore[attr-defined]


def test_unreadable_film_is_reported_in_a_line_without_its_path(client: TestClient) -> None:
    name = client.put("/api/films", content=b"no film at all").json()["film"]
    (error,) = [row["error"] for row in rows_of(client, {"kind": "film", "film": name}) if row["event"] == "error"]
    assert "the film" in error
    assert "/" not in error


def test_frames_need_increasing_times_and_one_size() -> None:
    camera = CameraFrames()
    camera.put(message(1.0, np.zeros((64, 64), np.uint8)))
    with pytest.raises(MediaError, match="increase"):
        camera.put(message(1.0, np.zeros((64, 64), np.uint8)))
    with pytest.raises(MediaError, match="same size"):
        camera.put(message(2.0, np.zeros((64, 32), np.uint8)))


def test_frames_above_the_limit_are_dropped_and_counted() -> None:
    camera = CameraFrames()
    for k in range(MAX_WAITING + 5):
        camera.put(message(float(k), np.zeros((64, 64), np.uint8), k))
    camera.end()
    assert (camera.dropped, [frame.index for frame in camera]) == (5, list(range(MAX_WAITING)))


@pytest.mark.slow
@pytest.mark.parametrize(("side", "rate_hz", "fps"), [(8, 10.0, 30.0), (32, 30.0, 60.0), (64, 30.0, 60.0)])
def test_rate_and_cells_are_measured(side: int, rate_hz: float, fps: float) -> None:
    scale = max(1, side // 32)
    phone = Phone(fps=fps, width=320 * scale, height=320 * scale, side_px=280.0 * scale, blur_px=0.8, seed=side)
    seen = phone_frames(grabs(side, rate_hz, 3.0), phone)
    frames = [Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(seen)]
    assert cells_of_a_side(frames) == side
    assert patterns_per_s(frames) == pytest.approx(rate_hz)


def test_noise_has_no_rate_and_no_cells() -> None:
    noise = np.random.default_rng(2)
    frames = [Frame(k, k / 30, noise.integers(80, 120, (120, 160), np.uint8)) for k in range(64)]
    assert (patterns_per_s(frames), cells_of_a_side(frames)) == (None, None)


@pytest.mark.parametrize(("measured", "meant"), [(10.04, 10.0), (14.43, 14.4), (1.99, 2.0), (13.0, 13.0)])
def test_rates_snap_to_those_of_displays(measured: float, meant: float) -> None:
    assert usual(measured) == pytest.approx(meant)
