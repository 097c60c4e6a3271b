"""Receptions of films, cameras and drives on page *Watch*."""

import contextlib
import json
import os
import threading
import time
from base64 import b64decode
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from cli_runs import succeeded, within
from fastapi.testclient import TestClient
from film_checks import write_levels
from played_camera import PlayedCamera
from starlette.testclient import WebSocketTestSession
from starlette.websockets import WebSocketDisconnect
from waiting import wait_until
from web_server import OWN, write_dark_film

import heliograph
from heliograph.base.frames import Frame
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.link.truth import truth_path
from heliograph.media import create_film, open_film
from heliograph.media.live.camera import register_camera
from heliograph.receive.geometry.pose import Pose
from heliograph.web.app import create_app
from heliograph.web.failures import FailureRecorder
from heliograph.web.recorded_drive import RECORDED_DRIVE, start_warm_up, warm_up
from heliograph.web.security import Access
from heliograph.web.shared import Limits
from heliograph.web.stores import Store, StoredFilm
from heliograph.web.watching.gate import Gate
from heliograph.web.watching.scene import Scene, SceneObserver
from heliograph.web.wording import COMMANDS, page_words

pytestmark = pytest.mark.usefixtures("quick_ends")
SOCKET = "ws://127.0.0.1:8000/api/watch"
SMALL = ["channel.camera.width=128", "channel.camera.height=96", "channel.duration_s=0.25",
         "channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0"]  # fmt: skip
SENT = {"high": [b"red"], "middle": [b"to the right"], "low": [bytes(range(200))]}


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("films") / "drive.h5"
    write_film(path, load_settings("static", None, SMALL), [SENT], seed=1)
    return path


@pytest.fixture(scope="module")
def dark(film: Path) -> Path:
    """The film with strong noise that hides most of the second packet."""
    path = film.with_name("half.h5")
    with open_film(film) as source:
        form = {"width": source.width, "height": source.height, "rate_hz": source.rate_hz, "bits": source.bits}
        with create_film(path, **form, metadata=source.metadata) as copy:  # type: ignore[arg-type]
            for frame in source:
                if frame.index > 115:
                    random = np.random.default_rng(frame.index)
                    noisy = frame.pixels + random.normal(0, 90, frame.pixels.shape)
                    frame = replace(frame, pixels=np.clip(noisy, 0, 255).astype(np.uint8))
                copy.write(frame)
    return path


@pytest.fixture(scope="module")
def client(film: Path, dark: Path) -> Iterator[TestClient]:
    app = create_app(films=[str(film), str(dark)], limits=Limits(sessions=2, place_s=2.0))
    with TestClient(app, base_url=OWN) as made:
        yield made


def parted(data: bytes) -> tuple[dict[str, Any], np.ndarray[Any, Any]]:
    length = int.from_bytes(data[:4], "little")
    picture = cv2.imdecode(np.frombuffer(data[4 + length :], np.uint8), cv2.IMREAD_GRAYSCALE)
    assert picture is not None
    return json.loads(data[4 : 4 + length]), picture


class Watched:
    def __init__(self, socket: Any, until: str = "end", took: bool = True):
        self.rows: list[dict[str, Any]] = []
        self.scenes: list[tuple[dict[str, Any], np.ndarray[Any, Any]]] = []
        while not any(row["event"] in (until, "failed") for row in self.rows):
            message = socket.receive()
            if message["type"] == "websocket.close":
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


@dataclass(frozen=True)
class Socket:
    client: TestClient
    session: WebSocketTestSession

    def do(self, command: str, **values: Any) -> None:
        self.session.send_json({"do": command, **values})

    def open(self, **source: Any) -> None:
        self.do("open", source=source)

    def watch(self, until: str = "end", took: bool = True) -> Watched:
        return Watched(self.session, until, took)

    def save(self, path: Path) -> dict[str, Any]:
        """Save what failed to a file; return the row of the server."""
        self.do("save")
        saved = self.watch("saved").of("saved")[0]
        answer = self.client.get(f"/api/bundles/{saved['bundle']}")
        assert len(answer.content) == saved["bytes"]
        path.write_bytes(answer.content)
        return saved


@contextlib.contextmanager
def connected(client: TestClient) -> Iterator[Socket]:
    with client.websocket_connect(SOCKET, ["heliograph"]) as session:
        assert session.accepted_subprotocol == "heliograph"
        yield Socket(client, session)


def watch(client: TestClient, **source: Any) -> Watched:
    with connected(client) as socket:
        socket.open(**source)
        return socket.watch()


@pytest.fixture(scope="module", params=["plain", "soft"])
def watched(client: TestClient, request: pytest.FixtureRequest) -> Watched:
    """A film watched to the end with each receiver."""
    return watch(client, kind="named", number=0, receiver=request.param)


@pytest.mark.slow
def test_sources_of_the_server_are_listed_without_folders(client: TestClient, film: Path) -> None:
    found = client.get("/api/watch/sources").json()
    assert found["named"] == ["drive.h5", "half.h5"]
    assert str(film.parent) not in json.dumps(found)
    assert {"plain", "soft"} <= set(found["receivers"])
    assert "paper" in [one["name"] for one in found["presets"]]
    assert "cameras" in client.get("/api/watch/cameras").json()


@pytest.mark.parametrize(("source", "receiver"), [
    ({}, "soft"), ({"receiver": "plain"}, "plain"), ({"changes": ["receive.receiver=plain"]}, "plain"),
    ({"kind": "drive"}, "soft"), ({"kind": "drive", "preset": "phone"}, "screen"),
])  # fmt: skip
def test_film_decides_the_receiver_unless_one_is_named(film: Path, source: Any, receiver: str) -> None:
    with TestClient(create_app(films=[str(film)], is_auto=True), base_url=OWN) as client, connected(client) as socket:
        socket.do("open", source={"kind": "named"} | source, paused=True)
        assert socket.watch("source").of("source")[0]["receiver"] == receiver


def test_film_with_an_unprintable_name_is_watched(tmp_path: Path) -> None:
    odd, gone = (tmp_path / os.fsdecode(name) for name in (b"caf\xe9\n#%?.h5", b"\xff"))
    write_levels(odd, np.zeros((1, 16, 16), np.uint8))
    with TestClient(create_app(films=[str(odd), str(gone), "."]), base_url=OWN) as client:
        assert client.get("/api/watch/sources").json()["named"] == [r"caf\xe9\n#%?.h5", r"\xff", "."]
        seen = watch(client, kind="named", number=0)
        assert seen.of("source")[0]["name"] == r"caf\xe9\n#%?.h5"
        assert seen.of("failed")[0]["reason"].startswith(r"caf\xe9\n#%?.h5 has 1 frame")
        (refused,) = watch(client, kind="named", number=1).of("failed")
        assert refused["reason"] == r"there is no file \xff: check the name"


@pytest.mark.slow
def test_page_shows_array_packets_messages_and_errors(watched: Watched) -> None:
    source = watched.of("source")[0]
    assert (source["width"], source["height"], source["truth"]) == (128, 96, True)
    packets = watched.of("packet")
    assert [packet["status"] for packet in packets] == ["ok", "ok"]
    messages = {message["layer"]: b64decode(message["data"]) for message in watched.of("message")}
    assert messages == {"high": b"red", "middle": b"to the right", "low": bytes(range(200))}
    about, picture = watched.scenes[-1]
    assert picture.shape == (96, 128)
    box = np.array(about["boxes"][0]["corners"])
    assert about["boxes"][0]["distance_m"] == pytest.approx(50, rel=0.02)
    assert box.mean(axis=0) == pytest.approx([63.5, 47.5], abs=3)
    state = watched.of("state")[-1]
    assert state["frames"] == 250
    assert {"follow", "decode", "search", "read"} <= set(state["stages"])
    assert (state["left_out"], state["false_codewords"]) == ({"candidates": 0, "blocks": 0}, 0)
    assert sum(layer["wrong"] for row in state["errors"] for layer in row["layers"].values()) == 0
    assert sum(row["layers"]["high"]["sent"] for row in state["errors"]) == 2


def picture(light: dict[str, Any], name: str) -> np.ndarray[Any, np.dtype[np.uint8]]:
    return np.frombuffer(b64decode(light[name]["data"]), np.uint8)


def likeness(light: dict[str, Any]) -> float:
    """Correlate the received light at the LEDs with the decided levels."""
    places = np.round((np.arange(16) - 7.5) * 72 / (1.3 * 16) + 35.5).astype(int)
    received = picture(light, "received").reshape(72, 72)[np.ix_(places, places)]
    return float(np.corrcoef(received.ravel(), picture(light, "decided"))[0, 1])


@pytest.mark.slow
def test_page_shows_light_of_a_packet_received_equalised_and_decided(watched: Watched) -> None:
    light = watched.of("light")[0]
    assert light["received"]["rows"] == light["received"]["columns"] == 72
    assert set(picture(light, "decided")) <= {0, 63, 127, 191, 255}
    # the decided levels equal the received levels except for noise and blur
    assert np.corrcoef(picture(light, "equalised"), picture(light, "decided"))[0, 1] > 0.85
    assert likeness(light) > 0.7
    for name, layer in light["layers"].items():
        assert layer["known"] == sum(layer["zeros"]) + sum(layer["ones"])
        assert not any(layer["open"])
        assert layer["wrong"] < (1 if name == "high" else 0.05 * layer["known"])
        assert sum(layer["zeros"][:10]) + sum(layer["ones"][-10:]) < 0.02 * layer["known"]


@pytest.mark.slow
def test_failed_packets_are_saved_and_open_again(client: TestClient, tmp_path: Path) -> None:
    saved_film = tmp_path / "failed.h5"
    with connected(client) as socket:
        socket.open(kind="named", number=1)
        seen = socket.watch()
        assert {packet["status"] for packet in seen.of("packet")} > {"ok"}
        saved = socket.save(saved_film)
    with open_film(saved_film) as kept:
        frames = [frame.index for frame in kept]
    failed = next(packet for packet in seen.of("packet") if packet["status"] != "ok")
    assert frames[0] <= failed["first_frame"] - 99
    assert frames[-1] >= failed["last_frame"]
    assert client.get(f"/api/bundles/{saved['bundle']}").status_code == 404  # the page is closed
    name = client.put("/api/films?kind=h5", content=saved_film.read_bytes()).json()["film"]
    again = watch(client, kind="film", film=name)
    assert failed["time_s"] in [packet["time_s"] for packet in again.of("packet")]
    assert not again.of("source")[0]["truth"]  # uploads have no truth
    assert "errors" not in again.of("state")[-1]


def saved_frames(recorder: FailureRecorder) -> list[Frame]:
    """Save what failed below 50 MB and of about the stated size; return the frames."""
    store, stated = Store[StoredFilm](1, "", StoredFilm.drop), recorder.size
    saved = recorder.save(store)
    assert saved["bytes"] == pytest.approx(stated, rel=0.02)
    assert max(stated, saved["bytes"]) < 50_000_000
    with open_film(store.of(saved["bundle"]).path) as kept:
        return list(kept)


@pytest.mark.slow
def test_saved_film_is_a_window_about_the_array_below_50_mb(tmp_path: Path) -> None:
    recorder = FailureRecorder(tmp_path, load_settings("paper").signal, rate_hz=1000.0)
    pixels = np.zeros((512, 1024), np.uint8)
    pixels[200, 700] = 255
    pose = Pose(700.0, 200.0, 2.0)
    for k in range(5000):
        recorder.add_frame(Frame(k, k / 1000, pixels))
        if k == 260 or (k > 300 and k % 100 == 60):
            packet: Any = SimpleNamespace(status="crc_fail", start_time_s=(k - 110) / 1000, pose=pose)
            recorder.add_packet(packet)
        if k == 299:
            frames = saved_frames(recorder)
            assert (frames[0].pixels.shape, frames[0].pixels[128, 128]) == ((256, 256), 255)
            assert (frames[0].index, frames[-1].index) == (30, 270)
    assert saved_frames(recorder)


def test_last_frames_of_a_large_film_stay_below_50_mb(tmp_path: Path) -> None:
    recorder = FailureRecorder(tmp_path, load_settings("paper").signal)
    for k in range(150):
        recorder.add_frame(Frame(k, k / 1000, np.zeros((512, 1024), np.uint8)))
    assert saved_frames(recorder)[-1].index == 149


@pytest.mark.parametrize("command", ["", "stop"])
def test_first_picture_is_shown_before_the_receiver_is_compiled(tmp_path: Path, command: str) -> None:
    app = create_app(films=[str(write_dark_film(tmp_path / "dark.h5", 120))])
    app.state.shared.is_compiled.clear()
    with TestClient(app, base_url=OWN) as client, connected(client) as page:
        page.open(kind="named", number=0, receiver="plain")
        while not (message := page.session.receive()).get("bytes"):
            assert json.loads(message["text"])["event"] == "source"
        assert parted(message["bytes"])[0]["frame"] == 0
        page.do(command) if command else app.state.shared.is_compiled.set()
        seen = page.watch()
    assert seen.of("state")[-1]["frames"] == (1 if command == "stop" else 120)


def test_first_start_compiles_in_a_second_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The memory of the compiler would stay with the server."""
    is_compiled, ends, warm = threading.Event(), threading.Event(), threading.Event()
    processes = list[Any]()

    def process(target: Any, args: Any, daemon: bool) -> Any:
        def join() -> None:
            assert ends.wait(60)
            args[0].touch()

        parts = {"start": lambda: None, "join": join, "pid": 1, "exitcode": 0}
        processes.append(SimpleNamespace(**parts, is_stopped_with_the_server=daemon))
        return processes[-1]

    monkeypatch.setattr("heliograph.web.recorded_drive.cache_folder", lambda: tmp_path)
    monkeypatch.setattr("heliograph.web.recorded_drive.warm_up", warm.set)
    monkeypatch.setattr("multiprocessing.get_context", lambda _: SimpleNamespace(Process=process))
    is_compiled.set()
    start_warm_up(is_compiled)
    assert processes[0].is_stopped_with_the_server
    assert not is_compiled.is_set()
    assert not warm.is_set()  # functions load from the cache afterwards
    ends.set()
    assert is_compiled.wait(60)
    assert warm.wait(60)
    start_warm_up(is_compiled)
    assert len(processes) == 1
    assert is_compiled.is_set()


@pytest.mark.slow
def test_recorded_drive_is_small_warms_up_the_receiver_and_is_the_source_without_films() -> None:
    assert sum(file.stat().st_size for file in (RECORDED_DRIVE, truth_path(RECORDED_DRIVE))) < 3_000_000
    assert warm_up()
    with TestClient(create_app(), base_url=OWN) as client:
        assert client.get("/api/watch/sources").json()["recorded"]
        seen = watch(client, kind="named", number=0, receiver="soft")
    assert seen.scenes[0][0]["frame"] == 0  # before the first search
    state = seen.of("state")[-1]
    assert (state["frames"], state["false_codewords"]) == (3293, 0)
    packets = seen.of("packet")
    assert len(packets) == 33
    wrong = [
        (round(packet["distance_m"]), layer)
        for packet in packets
        for layer, words in packet["layers"].items()
        for word in words
        if word["status"] != "ok"
    ]
    # the codeword at 78 m depends on the kernels that OpenBLAS chooses for the processor
    assert wrong in ([(80, "low")], [(80, "low"), (78, "low")])
    assert {"high", "middle", "low"} == {row["layer"] for row in seen.of("message")}


@pytest.mark.parametrize(("message", "words"), [
    ("give the rate; pass the camera's true rate with --fps", "pass the camera's true rate with the field Frame rate"),
    ("too faint: come nearer, or lower the limit: --set receive.detect.min_contrast=2", "too faint: come nearer"),
    ("a film has at most 9 bytes: name it on the command line", "start the server with it"),
    ("short mode needs signal.data_pairs = 13, not 48", "short mode needs data pairs = 13, not 48"),
    ("read it by --receiver soft", "read it by the receiver soft"),
])  # fmt: skip
def test_messages_are_in_the_words_of_the_pages_but_keep_settings_that_the_user_typed(message: str, words: str) -> None:
    said = page_words(message)
    assert words in said
    assert not COMMANDS.search(said)
    assert page_words("signal.side: 7 is not a multiple of 4", ["signal.side=7"]).startswith("signal.side")


@pytest.mark.slow
def test_page_without_acknowledged_scenes_gets_two_scenes_and_all_rows(client: TestClient, tmp_path: Path) -> None:
    with connected(client) as socket:
        socket.open(kind="named", number=0)
        seen = socket.watch(took=False)
        socket.save(tmp_path / "last.h5")
    assert (len(seen.scenes), len(seen.of("packet")), seen.of("state")[-1]["frames"]) == (2, 2, 250)
    with open_film(tmp_path / "last.h5") as kept:  # the last frames, as no packet failed
        assert sum(1 for _ in kept) > 200


@pytest.mark.slow
def test_stopped_drive_is_saved_and_received_by_the_command(client: TestClient, tmp_path: Path) -> None:
    with connected(client) as socket:
        socket.open(kind="drive", preset="static", distance_m=50.0, street=False)
        socket.watch("packet")
        socket.do("stop")
        socket.watch()
        socket.save(tmp_path / "failed.h5")
    assert "array 0: 1 packet" in succeeded(within(tmp_path, "receive", "failed.h5", "--output", "got"))


@pytest.mark.slow
def test_live_camera_is_watched_until_its_end(film: Path, tmp_path: Path) -> None:
    register_camera("played", PlayedCamera)
    app = create_app(films=[f"camera:played:{film}"], camera=["Times=2"])
    with TestClient(app, base_url=OWN) as client, connected(client) as socket:
        assert client.get("/api/watch/sources").json()["named"] == [f"camera:played:{film}"]
        socket.open(kind="named")
        seen = socket.watch()
        socket.save(tmp_path / "failed.h5")
    assert seen.of("source")[0]["live"]
    assert len(seen.of("packet")) >= 2
    assert seen.of("end")
    with open_film(tmp_path / "failed.h5") as kept:
        assert sum(1 for _ in kept) > 200


@pytest.mark.slow
def test_silent_camera_is_stopped(film: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.watching.run.warm_up", lambda *_: None)
    register_camera("played", PlayedCamera)
    app = create_app(films=[f"camera:played:{film}"], camera=["Times=0", "Speed=0.001"])
    with TestClient(app, base_url=OWN) as client, connected(client) as socket:
        socket.open(kind="named")
        socket.watch("source")
        socket.do("stop")
        socket.open(kind="film", film="none")
        assert socket.watch().of("failed")


@pytest.mark.slow
def test_page_steps_through_frames_and_packets(client: TestClient) -> None:
    with connected(client) as socket:
        socket.do("open", source={"kind": "named", "number": 0}, paused=True)
        socket.watch("state")
        for values, frames in (({}, 1), ({}, 2), ({"frames": 40}, 42)):
            socket.do("step", **values)
            assert socket.watch("state").rows[-1]["frames"] == frames
        socket.do("packet")
        seen = socket.watch("packet")
        socket.do("took")
        state = socket.watch("state").rows[-1]
        assert (state["paused"], state["frames"] < 250, len(seen.of("packet"))) == (True, True, 1)
        socket.do("go")
        assert socket.watch().of("state")[-1]["frames"] == 250


@pytest.mark.parametrize(("source", "reason"), [
    ({"kind": "film", "film": "../../etc/passwd"}, "not here any more"),
    ({"kind": "film"}, "the film is not a video that can be read"),
    ({"kind": "named", "number": 9}, "there is no film 9"),
    ({"kind": "drive", "preset": "nowhere"}, "unknown preset"),
    ({"kind": "named", "number": 0, "receiver": "none"}, "receiver"),
    ({"kind": "named", "number": 0, "changes": ["channel.distance_m=3"]}, "signal and receive"),
    ({"kind": "named", "number": 0, "changes": ["signal.side=7"]}, "signal.side"),
])  # fmt: skip
def test_invalid_sources_are_rejected_in_a_line(client: TestClient, source: Any, reason: str) -> None:
    damaged = client.put("/api/films?kind=mp4", content=b"no film at all" * 50).json()
    said = watch(client, **(damaged | source)).of("failed")[0]["reason"]
    assert reason in said
    assert "\n" not in said


def test_invalid_commands_are_refused(client: TestClient) -> None:
    commands = ["", "{", "[]", '{"do":"dance"}', '{"do":"open","source":{"kind":"film","path":"/"}}']
    with connected(client) as socket:
        for text in commands:
            socket.session.send_text(text)
            assert socket.session.receive_json() == {"event": "refused", "reason": "invalid command"}


@pytest.mark.parametrize(
    "headers", [{"origin": "https://evil.example"}, {"host": "evil.example"}, {"sec-fetch-site": "cross-site"}]
)
def test_sockets_of_other_sites_are_rejected(client: TestClient, headers: dict[str, str]) -> None:
    with pytest.raises(WebSocketDisconnect), client.websocket_connect(SOCKET, headers=headers):
        pass


@pytest.mark.parametrize(("offered", "is_accepted"), [("token.right", True), ("token.wrong", False), ("right", False)])
def test_socket_requires_the_token(offered: str, is_accepted: bool) -> None:
    refusal = contextlib.nullcontext() if is_accepted else pytest.raises(WebSocketDisconnect)
    with (
        TestClient(create_app(access=Access(token="right")), base_url=OWN) as client,
        refusal, client.websocket_connect(SOCKET, ["heliograph", offered]) as socket,
    ):  # fmt: skip
        assert socket.accepted_subprotocol == "heliograph"


@pytest.mark.slow
def test_number_of_pages_is_limited_until_receptions_end_as_pages_disconnect(client: TestClient) -> None:
    places = client.app.state.shared.sessions  # type: ignore[attr-defined]
    with connected(client) as socket, connected(client), client.websocket_connect(SOCKET) as third:
        socket.do("open", source={"kind": "named", "number": 0}, paused=True)
        socket.watch("state")
        assert places.taken == 2
        assert "2 receptions run already" in third.receive_json()["reason"]
        with pytest.raises(WebSocketDisconnect):
            third.receive_json()
    wait_until(lambda: places.taken == 0)  # a place stays occupied until the worker ends


def test_page_awaits_the_place_of_an_ending_reception(client: TestClient) -> None:
    with connected(client), contextlib.ExitStack() as stack:
        stack.enter_context(connected(client))
        with connected(client) as third:
            stack.close()
            third.open(kind="named", number=0)
            assert third.watch("source").of("source")


def test_frames_wait_for_their_time_at_a_speed() -> None:
    gate, began = Gate(speed=10.0), time.monotonic()
    assert all(gate.pass_through(k / 10) for k in range(3))
    assert time.monotonic() - began >= 0.02


SCREEN = ("channel.camera.width=480", "channel.camera.height=270", "channel.camera.pixel_m=1.1e-5",
          "channel.camera.row_time_s=5e-5", "channel.distance_m=0.75", "channel.duration_s=1.2",
          "receive.calibration.pixel_m=1.1e-5")  # fmt: skip


@pytest.mark.slow
def test_screen_is_drawn_with_box_cut_outs_and_light() -> None:
    settings = load_settings("phone-60", None, SCREEN)
    seen = SceneObserver(settings.signal, settings.receive.calibration)
    receiver = heliograph.make_receiver(settings.signal, settings.receive, seen)
    scenes, light = list[Scene](), list[dict[str, Any]]()
    for frame, _ in simulate(settings, default_messages(settings), 3):
        for packet in receiver.push(frame):
            assert packet.status == "ok"
        light += seen.packet_rows()
        scenes.append(seen.scene(frame))
    drawn = [one for one in scenes if one.boxes]
    assert len(drawn) > 20
    assert all(one.boxes[0]["distance_m"] == pytest.approx(0.75, rel=0.1) for one in drawn)
    has_cut = [bool(one.cuts) for one in drawn]
    assert sum(has_cut) > 15
    assert all(has_cut[has_cut.index(True) :]), "the cut-out flickers"
    assert likeness(light[0]) > 0.5
