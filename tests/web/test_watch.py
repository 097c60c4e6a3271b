import json
import os
import threading
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import played_camera  # noqa: F401 - registers camera:played
import pytest
from cli_runs import called
from fastapi.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from heliograph.base.frames import Frame
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.media import create_film, open_film
from heliograph.web.app import create_app
from heliograph.web.failures import MAX_BUNDLES, Bundles
from heliograph.web.limits import Limits
from heliograph.web.security import Access

OWN = "http://127.0.0.1:8000"
SOCKET = "ws://127.0.0.1:8000/api/watch"
SMALL = [
    "channel.camera.width=128",
    "channel.camera.height=96",
    "channel.duration_s=0.25",
    "channel.arrays.0.x_m=0",
    "channel.arrays.0.y_m=0",
]
SENT = {"high": [b"red"], "middle": [b"to the right"], "low": [bytes(range(200))]}


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("films") / "drive.h5"
    write_film(path, load_settings("static", None, SMALL), [SENT], seed=1)
    return path


@pytest.fixture(scope="module")
def dark(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create a film with two packets; strong noise hides most of the second."""
    path = tmp_path_factory.mktemp("films") / "half.h5"
    settings = load_settings("static", None, SMALL)
    whole = path.with_name("whole.h5")
    write_film(whole, settings, [SENT], seed=1)
    with open_film(whole) as source:
        form = {"width": source.width, "height": source.height, "rate_hz": source.rate_hz, "bits": source.bits}
        with create_film(path, **form, metadata=source.metadata) as copy:  # type: ignore[arg-type]
            for frame in source:
                if frame.index > 115:
                    random = np.random.default_rng(frame.index)
                    noisy = frame.pixels + random.normal(0, 90, frame.pixels.shape)
                    frame = replace(frame, pixels=np.clip(noisy, 0, 255).astype(np.uint8))
                copy.write(frame)
    return path


@pytest.fixture
def client(film: Path, dark: Path) -> Iterator[TestClient]:
    app = create_app(films=[str(film), str(dark)], limits=Limits(sessions=2))
    with TestClient(app, base_url=OWN) as made:
        yield made


def parted(data: bytes) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    length = int.from_bytes(data[:4], "little")
    picture = cv2.imdecode(np.frombuffer(data[4 + length :], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    return json.loads(data[4 : 4 + length]), picture


class Watched:
    """Collect all messages to a page until an event."""

    def __init__(self, socket: Any, until: str = "end", took: bool = True):
        self.rows: list[dict[str, Any]] = []
        self.scenes: list[tuple[dict[str, Any], np.ndarray[Any, Any]]] = []
        self.closed: int | None = None
        while not any(row["event"] in (until, "failed") for row in self.rows):
            message = socket.receive()
            if message["type"] == "websocket.close":
                self.closed = message["code"]
                return
            if message.get("bytes"):
                self.scenes.append(parted(message["bytes"]))
                if took:
                    socket.send_json({"do": "took"})
            else:
                self.rows.append(json.loads(message["text"]))
                socket.send_json({"do": "heard", "rows": len(self.rows)})

    def of(self, event: str) -> list[dict[str, Any]]:
        return [row for row in self.rows if row["event"] == event]


def until_closed(socket: Any) -> tuple[list[str], int]:
    """Return texts until the server closes the connection, and the close code."""
    texts = []
    while (message := socket.receive())["type"] != "websocket.close":
        texts += [message["text"]] if "text" in message else []
    return texts, message["code"]


def watch(client: TestClient, **source: Any) -> Watched:
    with client.websocket_connect(SOCKET, ["heliograph"]) as socket:
        assert socket.accepted_subprotocol == "heliograph"
        socket.send_json({"do": "open", "source": source})
        return Watched(socket)


def test_what_may_be_watched(client: TestClient, film: Path) -> None:
    found = client.get("/api/watch/sources").json()
    assert found["named"] == ["drive.h5", "half.h5"]
    assert str(film.parent) not in json.dumps(found)
    assert {"plain", "soft"} <= set(found["receivers"])
    assert "paper" in [one["name"] for one in found["presets"]]
    assert "cameras" in client.get("/api/watch/cameras").json()


def test_a_film_of_any_name_is_offered_and_watched(tmp_path: Path) -> None:
    odd, gone = (tmp_path / os.fsdecode(name) for name in (b"caf\xe9\n#%?.h5", b"\xff"))
    form = {"width": 16, "height": 16, "rate_hz": 1000.0}
    with create_film(odd, **form) as film:  # type: ignore[arg-type]
        film.write(Frame(0, 0.0, np.zeros((16, 16), np.uint8)))
    with TestClient(create_app(films=[str(odd), str(gone), "."]), base_url=OWN) as client:
        assert client.get("/api/watch/sources").json()["named"] == [r"caf\xe9\n#%?.h5", r"\xff", "."]
        seen = watch(client, kind="named", number=0)
        assert seen.of("source")[0]["name"] == r"caf\xe9\n#%?.h5"
        assert seen.of("failed")[0]["reason"].startswith(r"caf\xe9\n#%?.h5 has 1 frame")
        (refused,) = watch(client, kind="named", number=1).of("failed")
        assert refused["reason"] == r"there is no file \xff: check the name"


@pytest.mark.slow
@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_a_film_is_shown_with_its_array_packets_messages_and_errors(client: TestClient, receiver: str) -> None:
    seen = watch(client, kind="named", number=0, receiver=receiver)
    source = seen.of("source")[0]
    assert (source["width"], source["height"], source["receiver"], source["truth"]) == (128, 96, receiver, True)
    packets = seen.of("packet")
    assert [packet["status"] for packet in packets] == ["ok", "ok"]
    messages = {message["layer"]: b64decode(message["data"]) for message in seen.of("message")}
    assert messages == {"high": b"red", "middle": b"to the right", "low": bytes(range(200))}
    about, picture = seen.scenes[-1]
    assert picture.shape == (96, 128)
    box = np.array(about["boxes"][0]["corners"])
    assert about["boxes"][0]["distance_m"] == pytest.approx(50, rel=0.02)
    assert box.mean(axis=0) == pytest.approx([63.5, 47.5], abs=3)
    state = seen.of("state")[-1]
    assert state["frames"] == 250
    assert {"follow", "decode", "search", "read"} <= set(state["stages"])
    assert state["false_codewords"] == 0
    assert sum(layer["wrong"] for row in state["errors"] for layer in row["layers"].values()) == 0
    assert sum(row["layers"]["high"]["sent"] for row in state["errors"]) == 2


@pytest.mark.slow
def test_what_the_search_left_out_is_told(client: TestClient) -> None:
    assert watch(client, kind="named", number=1).of("state")[-1]["left_out"] == {"candidates": 0, "blocks": 0}


@pytest.mark.slow
@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_a_packets_light_is_shown_as_received_equalised_and_decided(client: TestClient, receiver: str) -> None:
    light = watch(client, kind="named", number=0, receiver=receiver).of("light")[0]
    pictures = {name: np.frombuffer(b64decode(light[name]["data"]), np.uint8) for name in ("equalised", "decided")}
    assert light["received"]["rows"] == light["received"]["columns"] == 72
    assert set(pictures["decided"]) <= {0, 63, 127, 191, 255}
    # the decided levels equal the received levels except for noise and blur
    assert np.corrcoef(pictures["equalised"], pictures["decided"])[0, 1] > 0.85
    received = np.frombuffer(b64decode(light["received"]["data"]), np.uint8).reshape(72, 72)
    places = np.round((np.arange(16) - 7.5) * 72 / (1.3 * 16) + 35.5).astype(int)
    assert np.corrcoef(received[np.ix_(places, places)].ravel(), pictures["decided"])[0, 1] > 0.7
    for name, layer in light["layers"].items():
        assert layer["known"] == sum(layer["zeros"]) + sum(layer["ones"])
        assert not any(layer["open"])
        assert layer["wrong"] < (1 if name == "high" else 0.05 * layer["known"])
        assert sum(layer["zeros"][:10]) + sum(layer["ones"][-10:]) < 0.02 * layer["known"]


@pytest.mark.slow
def test_an_uploaded_film_is_watched_without_its_truth(client: TestClient, film: Path) -> None:
    name = client.put("/api/films?kind=h5", content=film.read_bytes()).json()["film"]
    seen = watch(client, kind="film", film=name)
    assert len(seen.of("packet")) == 2
    assert not seen.of("source")[0]["truth"]
    assert "errors" not in seen.of("state")[-1]


@pytest.mark.slow
def test_what_failed_is_saved_and_opens_again(client: TestClient, tmp_path: Path) -> None:
    with client.websocket_connect(SOCKET) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named", "number": 1}})
        seen = Watched(socket)
        assert {packet["status"] for packet in seen.of("packet")} > {"ok"}
        socket.send_json({"do": "save"})
        saved = Watched(socket, "saved").of("saved")[0]
        answer = client.get(f"/api/bundles/{saved['bundle']}")
    again = tmp_path / "failed.h5"
    again.write_bytes(answer.content)
    assert len(answer.content) == saved["bytes"]
    with open_film(again) as kept:
        frames = [frame.index for frame in kept]
    failed = next(packet for packet in seen.of("packet") if packet["status"] != "ok")
    assert frames[0] <= failed["first_frame"] - 99
    assert frames[-1] >= failed["last_frame"]
    with TestClient(create_app(films=[str(again)]), base_url=OWN) as other:
        assert failed["time_s"] in [one["time_s"] for one in watch(other, kind="named").of("packet")]
    assert client.get(f"/api/bundles/{saved['bundle']}").status_code == 404  # the page is closed


@pytest.mark.slow
def test_the_last_frames_are_saved_where_nothing_failed(client: TestClient, tmp_path: Path) -> None:
    with client.websocket_connect(SOCKET) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named", "number": 0}})
        Watched(socket)
        socket.send_json({"do": "save"})
        saved = Watched(socket, "saved").of("saved")[0]
        (tmp_path / "last.h5").write_bytes(client.get(f"/api/bundles/{saved['bundle']}").content)
    with open_film(tmp_path / "last.h5") as kept:
        assert sum(1 for _ in kept) > 200


@pytest.mark.slow
def test_a_drive_that_was_ended_is_saved_and_read_by_the_command(
    client: TestClient, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with client.websocket_connect(SOCKET) as socket:
        source = {"kind": "drive", "preset": "static", "distance_m": 50.0, "street": False}
        socket.send_json({"do": "open", "source": source})
        Watched(socket, "packet")
        socket.send_json({"do": "stop"})
        Watched(socket)
        socket.send_json({"do": "save"})
        saved = Watched(socket, "saved").of("saved")[0]
        (tmp_path / "failed.h5").write_bytes(client.get(f"/api/bundles/{saved['bundle']}").content)
    run = called("receive", tmp_path / "failed.h5", "--output", tmp_path / "got", capfd=capfd, monkeypatch=monkeypatch)
    assert run.returncode == 0, run.stderr
    assert "array 0: 1 packet" in run.stdout


def test_films_of_what_failed_are_kept_up_to_a_number(tmp_path: Path) -> None:
    kept, paths = Bundles(), [tmp_path / f"{k}.h5" for k in range(MAX_BUNDLES + 2)]
    for path in paths:
        path.touch()
    names = [kept.add(path) for path in paths]
    assert [path.exists() for path in paths] == [False] * 2 + [True] * MAX_BUNDLES
    assert [kept.of(name) for name in names[:3]] == [None, None, paths[2]]
    kept.drop(names[2])
    kept.drop("../../etc")
    assert not paths[2].exists()


@pytest.mark.slow
def test_a_live_camera_is_watched_until_it_ends(film: Path, tmp_path: Path) -> None:
    app = create_app(films=[f"camera:played:{film}"], camera=["Times=2"])
    with TestClient(app, base_url=OWN) as client, client.websocket_connect(SOCKET) as socket:
        assert client.get("/api/watch/sources").json()["named"] == [f"camera:played:{film}"]
        socket.send_json({"do": "open", "source": {"kind": "named"}})
        seen = Watched(socket)
        socket.send_json({"do": "save"})
        saved = Watched(socket, "saved").of("saved")[0]
        (tmp_path / "failed.h5").write_bytes(client.get(f"/api/bundles/{saved['bundle']}").content)
    with TestClient(create_app(films=[str(tmp_path / "failed.h5")]), base_url=OWN) as other:
        assert watch(other, kind="named").of("packet")
    assert seen.of("source")[0]["live"]
    assert len(seen.of("packet")) >= 2
    assert seen.of("end")


@pytest.mark.slow
def test_a_camera_that_gives_nothing_is_left(film: Path) -> None:
    silent = ["Times=0", "Speed=0.001"]
    app = create_app(films=[f"camera:played:{film}"], camera=silent)
    with TestClient(app, base_url=OWN) as client, client.websocket_connect(SOCKET) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named"}})
        Watched(socket, "source")
        socket.send_json({"do": "stop"})
        socket.send_json({"do": "open", "source": {"kind": "film", "film": "none"}})
        assert Watched(socket).of("failed")


@pytest.mark.slow
def test_frames_and_packets_are_stepped_through(client: TestClient) -> None:
    with client.websocket_connect(SOCKET) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named", "number": 0}, "paused": True})
        Watched(socket, "state")
        for number in (1, 2):
            socket.send_json({"do": "step"})
            assert Watched(socket, "state").rows[-1]["frames"] == number
        socket.send_json({"do": "packet"})
        seen = Watched(socket, "packet")
        socket.send_json({"do": "took"})
        rows = Watched(socket, "state").rows
        assert rows[-1]["paused"]
        assert rows[-1]["frames"] < 250
        assert len(seen.of("packet")) == 1
        socket.send_json({"do": "go"})
        assert Watched(socket).of("state")[-1]["frames"] == 250


@pytest.mark.slow
def test_a_page_that_draws_nothing_gets_two_scenes_and_every_row(client: TestClient) -> None:
    with client.websocket_connect(SOCKET) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named", "number": 0}})
        seen = Watched(socket, took=False)
    assert len(seen.scenes) == 2
    assert len(seen.of("packet")) == 2
    assert seen.of("state")[-1]["frames"] == 250


@pytest.mark.slow
def test_a_page_that_hears_nothing_is_let_go(client: TestClient, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.watching.session.ROWS_IN_FLIGHT", 1000)
    monkeypatch.setattr("heliograph.web.watching.outbox.MAX_WAITING", 5000)
    with client.websocket_connect(SOCKET) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named", "number": 0}})
        texts, code = until_closed(socket)
    assert code == 1013
    assert len(texts) < 12


@pytest.mark.parametrize(
    ("source", "reason"),
    [
        ({"kind": "film", "film": "../../etc/passwd"}, "not here any more"),
        ({"kind": "named", "number": 9}, "there is no film 9"),
        ({"kind": "drive", "preset": "nowhere"}, "unknown preset"),
        ({"kind": "named", "number": 0, "receiver": "none"}, "receiver"),
        ({"kind": "named", "number": 0, "changes": ["channel.distance_m=3"]}, "signal and receive"),
        ({"kind": "named", "number": 0, "changes": ["signal.side=7"]}, "signal.side"),
    ],
)
def test_a_source_that_will_not_do_is_refused_in_a_line(client: TestClient, source: Any, reason: str) -> None:
    said = watch(client, **source).of("failed")[0]["reason"]
    assert reason in said
    assert "\n" not in said


def test_a_damaged_film_is_refused_in_a_line(client: TestClient) -> None:
    name = client.put("/api/films?kind=mp4", content=b"no film at all" * 50).json()["film"]
    said = watch(client, kind="film", film=name).of("failed")[0]["reason"]
    assert said.startswith("the film is not a video that can be read")
    assert "\n" not in said


@pytest.mark.parametrize("text", ["", "{", "[]", '{"do":"dance"}', '{"do":"open","source":{"kind":"film","path":"/"}}'])
def test_what_is_no_command_is_refused_and_at_last_let_go(client: TestClient, text: str) -> None:
    with client.websocket_connect(SOCKET) as socket:
        for _ in range(40):
            socket.send_text(text)
        texts, code = until_closed(socket)
    assert {json.loads(one)["event"] for one in texts} == {"refused"}
    assert code == 1008


def test_more_pages_than_places_are_told_so(client: TestClient) -> None:
    with client.websocket_connect(SOCKET), client.websocket_connect(SOCKET), client.websocket_connect(SOCKET) as third:
        assert "2 receptions run already" in third.receive_json()["reason"]
        with pytest.raises(WebSocketDisconnect):
            third.receive_json()


@pytest.mark.parametrize(
    "headers", [{"origin": "https://evil.example"}, {"host": "evil.example"}, {"sec-fetch-site": "cross-site"}]
)
def test_sockets_of_other_sites_are_refused(client: TestClient, headers: dict[str, str]) -> None:
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(SOCKET, headers=headers):
        pass


@pytest.mark.parametrize(("offered", "let_in"), [("token.right", True), ("token.wrong", False), ("right", False)])
def test_a_socket_takes_the_token(offered: str, let_in: bool) -> None:
    with TestClient(create_app(access=Access(token="right")), base_url=OWN) as client:
        if let_in:
            with client.websocket_connect(SOCKET, ["heliograph", offered]) as socket:
                assert socket.accepted_subprotocol == "heliograph"
            return
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(SOCKET, ["heliograph", offered]):
            pass


@pytest.mark.slow
def test_no_thread_goes_on_when_its_page_has_gone(client: TestClient) -> None:
    with client.websocket_connect(SOCKET) as socket:
        socket.send_json({"do": "open", "source": {"kind": "named", "number": 0}, "paused": True})
        Watched(socket, "state")
        assert any(thread.name == "watch" for thread in threading.enumerate())
    for thread in threading.enumerate():
        if thread.name == "watch":
            thread.join(5)
            assert not thread.is_alive()
