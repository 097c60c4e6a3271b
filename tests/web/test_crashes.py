"""Unexpected exceptions in server workers reach page and log as a line of text, and end the connection."""

import asyncio
import json
import logging
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import played_camera
import pytest
from fastapi.testclient import TestClient

from heliograph.base.frames import Frame
from heliograph.media import create_film
from heliograph.media.reader import read_ahead
from heliograph.web.app import create_app
from heliograph.web.camera_frames import HEAD
from heliograph.web.crashes import report

OWN = "http://127.0.0.1:8000"
RECEIVE, WATCH = "ws://127.0.0.1:8000/api/receive", "ws://127.0.0.1:8000/api/watch"

ERRORS = [
    ValueError("need at least one array to stack"),
    RuntimeError("cannot schedule new futures"),
    TimeoutError("too late"),
    np.linalg.LinAlgError("Singular matrix"),
    MemoryError(),
    KeyError("layer"),
    StopIteration(),
    asyncio.CancelledError(),
    KeyboardInterrupt(),
    SystemExit(3),
    OSError(28, "No space left on device", "/tmp/heliograph-x/film.h5"),
    ValueError("cannot open /tmp/heliograph-x/0123.mp4\nsecond line"),
]
PASSED_ON = [ERRORS[0], *(one for one in ERRORS if isinstance(one, StopIteration) or not isinstance(one, Exception))]
"""Errors that threads and tasks pass on in different ways."""
INTERNAL = 1011

Rows = list[dict[str, Any]]


def raises(error: BaseException) -> Callable[..., Any]:
    def broken(*_values: Any, **_named: Any) -> Any:
        raise error

    return broken


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("films") / "dark.h5"
    with create_film(path, width=64, height=48, rate_hz=1000) as out:
        for k in range(40):
            out.write(Frame(k, k / 1000, np.full((48, 64), 20 + k % 2, np.uint8)))
    return path


@pytest.fixture
def client(film: Path) -> Iterator[TestClient]:
    with TestClient(create_app(films=[str(film), f"camera:played:{film}"]), base_url=OWN) as made:
        yield made


def rows_of(socket: Any) -> tuple[Rows, int]:
    """Return rows until the server closes, and the close code."""
    rows: Rows = []
    while (message := socket.receive())["type"] != "websocket.close":
        if message.get("text"):
            rows.append(json.loads(message["text"]))
            continue
        socket.send_json({"do": "took"})
    return rows, int(message["code"])


def is_logged_once(caplog: pytest.LogCaptureFixture, error: BaseException) -> bool:
    (record,) = [one for one in caplog.records if one.name.startswith("heliograph") and one.levelno >= logging.ERROR]
    return record.exc_info is not None and record.exc_info[1] is error


def is_one_clear_line(line: str, error: BaseException) -> bool:
    named = "not enough memory" if isinstance(error, MemoryError) else type(error).__name__
    named = "No space left" if isinstance(error, OSError) and error.errno == 28 else named
    return named in line and "\n" not in line and "/tmp" not in line and len(line) < 300


def received(client: TestClient, film: Path) -> tuple[Rows, int]:
    name = client.put("/api/films?kind=h5", content=film.read_bytes()).json()["film"]
    with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
        socket.send_json({"kind": "film", "film": name, "side": 16, "rate_hz": 10})
        return rows_of(socket)


def watched(client: TestClient, number: int = 0, then: str = "") -> tuple[Rows, int]:
    with client.websocket_connect(WATCH) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named", "number": number}})
        if then:
            socket.send_json({"do": then})
        return rows_of(socket)


@pytest.mark.parametrize("error", ERRORS, ids=lambda one: type(one).__name__)
def test_any_exception_is_reported_in_a_line_and_logged(error: BaseException, caplog: pytest.LogCaptureFixture) -> None:
    assert is_one_clear_line(report(error), error)
    assert is_logged_once(caplog, error)


@pytest.mark.parametrize("error", PASSED_ON, ids=lambda one: type(one).__name__)
def test_receive_reports_any_exception_of_its_worker_and_closes(
    client: TestClient,
    film: Path,
    error: BaseException,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr("heliograph.web.receive.PageReader.read_upload", raises(error))
    rows, code = received(client, film)
    assert [row["event"] for row in rows] == ["error"]
    assert is_one_clear_line(rows[0]["error"], error)
    assert code == INTERNAL
    assert is_logged_once(caplog, error)
    assert client.app.state.shared.sessions.taken == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize("error", PASSED_ON, ids=lambda one: type(one).__name__)
def test_watch_reports_any_exception_of_its_worker_and_closes(
    client: TestClient, error: BaseException, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("heliograph.web.watching.run.receive_film", raises(error))
    rows, code = watched(client)
    assert is_one_clear_line(rows[-1]["reason"], error)
    assert [row["event"] for row in rows].count("failed") == 1
    assert code == INTERNAL
    assert is_logged_once(caplog, error)


@pytest.mark.parametrize("error", PASSED_ON, ids=lambda one: type(one).__name__)
def test_transmit_answers_any_exception_of_its_worker_in_a_line(
    client: TestClient, error: BaseException, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("heliograph.web.transmit.sending_of", raises(error))
    answer = client.post("/api/transmit", content=b"text")
    assert answer.status_code == 500
    assert is_one_clear_line(answer.json()["error"], error)
    assert answer.headers["x-content-type-options"] == "nosniff"
    assert is_logged_once(caplog, error)


@pytest.mark.parametrize(
    "place",
    [
        "heliograph.web.reading.open_film",
        "heliograph.web.reading.estimate_link",
        "heliograph.web.reading.receive_film",
        "heliograph.web.reading.probe_film",
        "heliograph.measure.reception.make_receiver",
        "heliograph.web.failures.FailureRecorder.add_frame",
        "heliograph.web.failures.FailureRecorder.close",
        "heliograph.web.link_estimate.screen_settings",
    ],
)
def test_receive_reports_a_crash_wherever_it_is(
    client: TestClient, film: Path, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = ValueError("broken")
    monkeypatch.setattr(place, raises(error))
    rows, code = received(client, film)
    assert rows[-1]["event"] == "error"
    assert is_one_clear_line(rows[-1]["error"], error)
    assert code == INTERNAL


@pytest.mark.parametrize(
    "place", ["heliograph.web.receive.PageReader.read_camera", "heliograph.web.receive.CameraFrames.put"]
)
def test_receive_reports_a_crash_while_it_reads_a_camera(
    client: TestClient, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    error = ValueError("broken")
    monkeypatch.setattr(place, raises(error))
    with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
        socket.send_json({"kind": "camera"})
        socket.send_bytes(HEAD.pack(0.0, 0, 64, 64) + bytes(4096))
        rows, code = rows_of(socket)
    assert is_one_clear_line(rows[-1]["error"], error)
    assert code == INTERNAL


def test_receive_reports_a_crash_while_it_saves(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.failures.FailureRecorder.save", raises(ValueError("broken")))
    with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
        socket.send_json({"kind": "camera"})
        socket.send_text("save")
        rows, code = rows_of(socket)
    assert "ValueError: broken" in rows[-1]["error"]
    assert code == INTERNAL


@pytest.mark.parametrize(
    ("place", "number", "then"),
    [
        ("heliograph.web.watching.run.opened", 0, ""),
        ("heliograph.web.watching.run.FailureRecorder.add_frame", 0, ""),
        ("heliograph.web.watching.run.SceneObserver.scene", 0, ""),
        ("heliograph.web.watching.scene.Scene.encoded", 0, ""),
        ("heliograph.web.watching.session.save_bundle", 0, "save"),
        ("heliograph.web.watching.run.Run.halt", 0, "stop"),
        ("heliograph.media.hdf5.Hdf5Reader._frames", 0, ""),
        ("played_camera.PlayedCamera.open", 1, ""),
        ("played_camera.PlayedCamera.frames", 1, ""),
    ],
)
def test_watch_reports_a_crash_wherever_it_is(
    client: TestClient,
    place: str,
    number: int,
    then: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    error = ValueError("broken")
    monkeypatch.setattr(place, raises(error))
    monkeypatch.setattr("heliograph.web.watching.run.warm_up", lambda *_: None)
    rows, code = watched(client, number, then)
    # the short film may end without a packet before the command arrives
    failed = [row["reason"] for row in rows if row["event"] == "failed" and "record longer" not in row["reason"]]
    assert len(failed) == 1
    assert is_one_clear_line(failed[0], error)
    assert code == INTERNAL
    (record,) = [one for one in caplog.records if one.name.startswith("heliograph")]
    assert "ValueError: broken" in (logging.Formatter().format(record))
    assert "Traceback" in logging.Formatter().format(record)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), SystemExit(1), ValueError("broken")])
def test_the_end_of_a_cameras_thread_ends_its_reception(
    client: TestClient, error: BaseException, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(played_camera.PlayedCamera, "frames", raises(error))
    monkeypatch.setattr("heliograph.web.watching.run.warm_up", lambda *_: None)
    rows, code = watched(client, 1)
    assert type(error).__name__ in rows[-1]["reason"]
    assert code == INTERNAL


def test_an_expected_error_of_watch_leaves_the_page_connected(client: TestClient) -> None:
    with client.websocket_connect(WATCH) as socket:
        for _ in range(2):
            socket.send_json({"do": "open", "source": {"kind": "named", "number": 7}})
            assert "there is no film 7" in socket.receive_json()["reason"]


@pytest.mark.parametrize(
    ("place", "path"),
    [
        ("heliograph.web.sending.Sending.packets", "packets"),
        ("heliograph.web.transmit._write", "film?seconds=1"),
        ("heliograph.web.sending.Sendings.of", "packets"),
    ],
)
def test_transmit_answers_a_crash_wherever_it_is(
    client: TestClient, place: str, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = client.post("/api/transmit?side=8", content=b"text").json()["sending"]
    monkeypatch.setattr(place, raises(ValueError("broken")))
    answer = client.get(f"/api/transmit/{name}/{path}")
    assert answer.status_code == 500
    assert "ValueError: broken" in answer.json()["error"]
    assert not list(client.app.state.shared.uploads.folder().iterdir())  # type: ignore[attr-defined]


def test_a_crash_while_cameras_are_listed_is_answered_in_a_line(
    client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heliograph.web.watch.list_cameras", raises(ValueError("broken")))
    answer = client.get("/api/watch/cameras")
    assert (answer.status_code, "ValueError: broken" in answer.json()["error"]) == (500, True)


@pytest.mark.parametrize("error", [ValueError("broken"), KeyboardInterrupt(), SystemExit(1)])
def test_frames_read_ahead_end_with_any_exception_of_their_thread(error: BaseException) -> None:
    def frames() -> Generator[Frame, None, None]:
        yield Frame(0, 0.0, np.zeros((4, 4), np.uint8))
        raise error

    ahead = read_ahead(frames())
    next(ahead)
    with pytest.raises(type(error)):
        next(ahead)


def test_a_page_that_has_gone_is_not_logged_as_a_crash(client: TestClient, caplog: pytest.LogCaptureFixture) -> None:
    with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
        socket.send_json({"kind": "camera"})
    with client.websocket_connect(WATCH) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named"}})
    with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
        socket.send_text("nonsense")
        rows, code = rows_of(socket)
    assert ([row["event"] for row in rows], code) == (["error"], 1008)
    assert not [one for one in caplog.records if one.name.startswith("heliograph")]
