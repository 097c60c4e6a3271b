"""Ended receptions leave no objects in the server."""

import gc
import json
import threading
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from heliograph.base.frames import Frame
from heliograph.media import create_film
from heliograph.web.app import create_app

OWN = "http://127.0.0.1:8000"
RECEIVE, WATCH = "ws://127.0.0.1:8000/api/receive", "ws://127.0.0.1:8000/api/watch"
RECEPTIONS = 5


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("films") / "dark.h5"
    with create_film(path, width=64, height=48, rate_hz=1000) as out:
        for k in range(110):
            out.write(Frame(k, k / 1000, np.full((48, 64), 20 + k % 2, np.uint8)))
    return path


@pytest.fixture
def client(film: Path) -> Iterator[TestClient]:
    with TestClient(create_app(films=[str(film)]), base_url=OWN) as made:
        yield made


def receive(client: TestClient, film: Path) -> str:
    name = client.put("/api/films?kind=h5", content=film.read_bytes()).json()["film"]
    with client.websocket_connect(RECEIVE, ["heliograph"]) as socket:
        socket.send_json({"kind": "film", "film": name, "side": 16, "rate_hz": 10})
        event = ""
        while (message := socket.receive())["type"] != "websocket.close":
            event = str(json.loads(message["text"])["event"])
        return event


def watch(client: TestClient, receiver: str = "plain", until: str = "end") -> str:
    with client.websocket_connect(WATCH) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named", "receiver": receiver}})
        event = ""
        while event not in (until, "failed"):
            message = socket.receive()
            event = json.loads(message["text"])["event"] if message.get("text") else event
        return event


def live_objects() -> Counter[str]:
    """Count live objects from this package, by type."""
    gc.collect()
    names = (f"{type(one).__module__}.{type(one).__qualname__}" for one in gc.get_objects())
    return Counter(name for name in names if name.startswith("heliograph"))


def leaked(before: Counter[str]) -> dict[str, int]:
    """Return types with an extra object per reception; an idle thread may hold objects from its last call."""
    return {name: more for name, count in live_objects().items() if (more := count - before[name]) >= RECEPTIONS}


@pytest.mark.slow
@pytest.mark.parametrize("page", ["receive", "watch", "watch by soft", "watch broken off"])
def test_no_object_of_an_ended_reception_is_kept(client: TestClient, film: Path, page: str) -> None:
    def run() -> str:
        if page == "receive":
            return receive(client, film)
        return watch(client, "soft" if "soft" in page else "plain", "source" if "broken" in page else "end")

    assert run() != "failed"
    before = live_objects()
    for _ in range(RECEPTIONS):
        run()
    deadline = time.monotonic() + 60
    while (grown := leaked(before)) and time.monotonic() < deadline:  # wait for ending threads
        time.sleep(0.1)
    assert not grown


@pytest.mark.parametrize("page", [receive, lambda client, _: watch(client)], ids=["receive", "watch"])
def test_memory_is_released_when_a_reception_has_ended(
    client: TestClient, film: Path, page: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    monkeypatch.setattr("heliograph.web.crashes.release_memory", released.set)
    page(client, film)
    assert released.wait(60)
