"""Unexpected exceptions of the server become a line of text, and ended receptions leave no objects."""

import asyncio
import gc
import json
import logging
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from played_camera import PlayedCamera
from waiting import wait_until
from web_server import OWN, write_dark_film

from heliograph.media.live.camera import register_camera
from heliograph.web.app import create_app
from heliograph.web.camera_frames import HEAD
from heliograph.web.connection import INTERNAL, Outbox
from heliograph.web.crashes import CrashError, in_thread, report
from heliograph.web.shared import Limits

pytestmark = pytest.mark.usefixtures("quick_ends")
RECEIVE, WATCH = "ws://127.0.0.1:8000/api/receive", "ws://127.0.0.1:8000/api/watch"
ERRORS = [
    ValueError("need at least one array to stack"), RuntimeError("cannot schedule new futures"),
    TimeoutError("too late"), np.linalg.LinAlgError("Singular matrix"), MemoryError(), KeyError("layer"),
    StopIteration(), asyncio.CancelledError(), KeyboardInterrupt(), SystemExit(3),
    OSError(28, "No space left on device", "/tmp/heliograph-x/film.h5"),
    ValueError("cannot open /tmp/heliograph-x/0123.mp4\nsecond line"),
]  # fmt: skip
CAMERA_FRAME = HEAD.pack(0.0, 0, 64, 64) + bytes(4096)
Rows = list[dict[str, Any]]


def raises(error: BaseException) -> Callable[..., Any]:
    def broken(*_values: Any, **_named: Any) -> Any:
        raise error

    return broken


@pytest.fixture(scope="module")
def client(dark_film: Path) -> Iterator[TestClient]:
    register_camera("played", PlayedCamera)
    app = create_app(films=[str(dark_film), f"camera:played:{dark_film}"])
    with TestClient(app, base_url=OWN, raise_server_exceptions=False) as made:
        yield made


def rows_of(socket: Any, until: str = "") -> tuple[Rows, int]:
    """Return rows until an event, or until the server closes, and the close code."""
    rows: Rows = []
    while not rows or rows[-1]["event"] not in (until, "failed" if until else ""):
        if (message := socket.receive())["type"] == "websocket.close":
            return rows, int(message["code"])
        if message.get("text"):
            rows.append(json.loads(message["text"]))
        else:
            socket.send_json({"do": "took"})
    return rows, 0


def is_logged_once(caplog: pytest.LogCaptureFixture, error: BaseException) -> bool:
    """Return True if the log has one traceback, of the error or of its consequence."""
    (record,) = [one for one in caplog.records if one.name.startswith("heliograph") and one.levelno >= logging.ERROR]
    cause = record.exc_info[1] if record.exc_info else None
    while cause is not None and cause is not error:
        cause = cause.__cause__
    return cause is error


def is_one_clear_line(line: str, error: BaseException) -> bool:
    named = "not enough memory" if isinstance(error, MemoryError) else type(error).__name__
    named = "No space left" if isinstance(error, OSError) and error.errno == 28 else named
    return named in line and "\n" not in line and "/tmp" not in line and len(line) < 300


def received(client: TestClient, film: Path) -> tuple[Rows, int]:
    name = client.put("/api/films?kind=h5", content=film.read_bytes()).json()["film"]
    with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
        socket.send_json({"kind": "film", "film": name, "side": 16, "rate_hz": 10})
        return rows_of(socket)


def watched(
    client: TestClient, number: int = 0, then: str = "", until: str = "", receiver: str | None = None
) -> tuple[Rows, int]:
    with client.websocket_connect(WATCH) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named", "number": number, "receiver": receiver}})
        if then:
            socket.send_json({"do": then})
        return rows_of(socket, until)


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_any_exception_of_a_worker_is_reported_in_a_line_and_logged(
    error: BaseException, caplog: pytest.LogCaptureFixture
) -> None:
    """Page *Transmit* awaits `in_thread`, the other pages `Outbox.run` and `Outbox.send_to`."""

    async def run() -> None:
        with pytest.raises(CrashError):
            await in_thread(raises(error))
        outbox = Outbox()
        await outbox.run(raises(error))
        await outbox.send_to(None)  # type: ignore[arg-type]

    with pytest.raises(CrashError) as raised:
        asyncio.run(run())
    assert is_one_clear_line(report(raised.value), error)
    assert is_logged_once(caplog, error)


PLACES = [
    ("film", "heliograph.web.reading.open_film"), ("film", "heliograph.web.reading.probe_film"),
    ("film", "heliograph.web.failures.FailureRecorder.add_frame"),
    ("film", "heliograph.web.failures.FailureRecorder.close"),
    ("camera", "heliograph.web.receive.PageReader.read_camera"),
    ("camera", "heliograph.web.receive.CameraFrames.put"), ("save", "heliograph.web.failures.FailureRecorder.save"),
    ("watch", "heliograph.web.watching.run.opened"), ("watch", "heliograph.web.watching.scene.Scene.encoded"),
    ("watch", "heliograph.media.hdf5.Hdf5Reader._frames"),
    ("watch save", "heliograph.web.watching.session.Session._save"),
    ("watch stop", "heliograph.web.watching.run.Run.stop"), ("watch camera", "played_camera.PlayedCamera.open"),
    ("watch camera", "played_camera.PlayedCamera.frames"),
]  # fmt: skip
"""Interaction with a page, and the function that crashes: in the worker, in a handler, or while sending."""


@pytest.mark.parametrize(("interaction", "place"), PLACES, ids=[place.rpartition(".")[2] for _, place in PLACES])
def test_pages_report_a_crash_at_any_place(
    client: TestClient, dark_film: Path, interaction: str, place: str, monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:  # fmt: skip
    error = KeyboardInterrupt() if place.endswith("PlayedCamera.frames") else ValueError("broken")
    monkeypatch.setattr(place, raises(error))
    monkeypatch.setattr("heliograph.web.watching.run.warm_up", lambda *_: None)
    if interaction == "film":
        rows, code = received(client, dark_film)
    elif interaction.startswith("watch"):
        command = interaction.removeprefix("watch").strip()
        rows, code = watched(client, int(command == "camera"), command.removeprefix("camera"))
    else:
        with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
            socket.send_json({"kind": "camera"})
            socket.send_text("save") if interaction == "save" else socket.send_bytes(CAMERA_FRAME)
            rows, code = rows_of(socket)
    # the short film may end without a packet before a command arrives
    lines = [str(row.get("error") or row["reason"]) for row in rows if row["event"] in ("error", "failed")]
    (line,) = [line for line in lines if "record longer" not in line]
    assert is_one_clear_line(line, error)
    assert code == INTERNAL
    assert is_logged_once(caplog, error)
    wait_until(lambda: client.app.state.shared.sessions.taken == 0)  # type: ignore[attr-defined]


def test_expected_errors_and_lost_pages_are_no_crashes(client: TestClient, caplog: pytest.LogCaptureFixture) -> None:
    with client.websocket_connect(WATCH) as socket:
        for _ in range(2):
            socket.send_json({"do": "open", "source": {"kind": "named", "number": 7}})
            assert "there is no film 7" in socket.receive_json()["reason"]
    with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
        socket.send_json({"kind": "camera"})
    with client.websocket_connect(WATCH) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named"}})
    with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
        socket.send_text("nonsense")
        rows, code = rows_of(socket)
    assert ([row["event"] for row in rows], code) == (["error"], 1008)
    assert not [one for one in caplog.records if one.name.startswith("heliograph")]


@pytest.mark.parametrize(("place", "path"), [
    ("heliograph.web.transmit.body_of", ""),
    ("heliograph.web.sending.Sending.packets", "transmit/{}/packets"),
    ("heliograph.web.transmit._write", "transmit/{}/film?seconds=1"),
    ("heliograph.web.stores.Store.of", "transmit/{}/packets"), ("heliograph.web.watch.list_cameras", "watch/cameras"),
])  # fmt: skip
def test_requests_answer_a_crash(client: TestClient, place: str, path: str, monkeypatch: pytest.MonkeyPatch) -> None:
    name = client.post("/api/transmit?side=8", content=b"text").json()["sending"]
    monkeypatch.setattr(place, raises(ValueError("broken")))
    answer = client.get(f"/api/{path.replace('{}', name)}") if path else client.post("/api/transmit", content=b"text")
    assert (answer.status_code, answer.headers["x-content-type-options"]) == (500, "nosniff")
    assert "ValueError: broken" in answer.json()["error"]
    assert not list(client.app.state.shared.folder.glob("patterns-*"))  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film longer than a packet of 100 frames."""
    return write_dark_film(tmp_path_factory.mktemp("films") / "dark.h5", 110)


@pytest.fixture
def single(film: Path) -> Iterator[TestClient]:
    with TestClient(create_app(films=[str(film)], limits=Limits(sessions=1)), base_url=OWN) as made:
        yield made


def live_objects() -> Counter[str]:
    """Count live objects from this package, by type."""
    gc.collect()
    names = (f"{type(one).__module__}.{type(one).__qualname__}" for one in gc.get_objects())
    return Counter(name for name in names if name.startswith("heliograph"))


@pytest.mark.slow
def test_ended_receptions_keep_no_object(single: TestClient, film: Path) -> None:
    def receive() -> list[str]:
        pages = received(single, film), watched(single, until="end", receiver="soft")
        broken_off = watched(single, until="source", receiver="plain")
        return [rows[-1]["event"] for rows, _ in (*pages, broken_off)]

    assert receive() == ["end", "end", "source"]
    before, receptions = live_objects(), 3  # more than the bundles that a server for one session keeps, less the first
    for _ in range(receptions):
        receive()
    # threads may still end, and an idle thread may hold objects from its last call
    wait_until(lambda: all(count - before[name] < receptions for name, count in live_objects().items()))


@pytest.mark.slow
@pytest.mark.parametrize("page", ["receive", "watch"])
def test_memory_is_released_when_a_reception_has_ended(
    single: TestClient, film: Path, page: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    monkeypatch.setattr("heliograph.web.connection.release_memory", released.set)
    received(single, film) if page == "receive" else watched(single, until="end", receiver="plain")
    assert released.wait(60)
