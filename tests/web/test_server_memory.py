"""Ended receptions leave no objects in the server."""

import gc
import json
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient
from waiting import wait_until
from web_server import OWN, write_dark_film

from heliograph.web.app import create_app
from heliograph.web.limits import Limits

RECEIVE, WATCH = "ws://127.0.0.1:8000/api/receive", "ws://127.0.0.1:8000/api/watch"
# more than the bundles that a server for one session keeps, less the first
RECEPTIONS = 3


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A film longer than a packet of 100 frames."""
    return write_dark_film(tmp_path_factory.mktemp("films") / "dark.h5", 110)


@pytest.fixture
def client(film: Path) -> Iterator[TestClient]:
    with TestClient(create_app(films=[str(film)], limits=Limits(sessions=1)), base_url=OWN) as made:
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
@pytest.mark.usefixtures("quick_ends")
def test_ended_receptions_keep_no_object(client: TestClient, film: Path) -> None:
    pages: dict[str, Callable[[], str]] = {
        "receive": lambda: receive(client, film),
        "watch": lambda: watch(client, "soft"),
        "watch broken off": lambda: watch(client, until="source"),
    }
    assert [page() for page in pages.values()] == ["end", "end", "source"]
    before = live_objects()
    for page in pages.values():
        for _ in range(RECEPTIONS):
            page()
    wait_until(lambda: not leaked(before))  # threads may still end


@pytest.mark.slow
@pytest.mark.parametrize("page", [receive, lambda client, _: watch(client)], ids=["receive", "watch"])
def test_memory_is_released_when_a_reception_has_ended(
    client: TestClient, film: Path, page: Callable[[TestClient, Path], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    released = threading.Event()
    monkeypatch.setattr("heliograph.web.connection.release_memory", released.set)
    page(client, film)
    assert released.wait(60)
