from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fastapi.testclient import TestClient
from web_server import OWN

from heliograph.link.codec import decode
from heliograph.media import open_film
from heliograph.probe.screens import SIDES
from heliograph.signal.fountain.files import FileGatherer
from heliograph.signal.settings import LAYERS, RateSettings
from heliograph.web import sending
from heliograph.web.app import create_app
from heliograph.web.security import LOOPBACK, Access
from heliograph.web.sending import MAX_BYTES, screen_settings, sending_of


@pytest.mark.parametrize("side", SIDES)
def test_patterns_of_a_text_decode_to_the_text(client: TestClient, side: int) -> None:
    facts = client.post(f"/api/transmit?side={side}&rate_hz=12", content="für 12 s".encode()).json()
    answer = client.get(f"/api/transmit/{facts['sending']}/packets?first=3&count=2")
    patterns = np.frombuffer(answer.content, np.uint8).reshape(-1, side, side)
    assert len(patterns) == 2 * facts["packet_patterns"]
    settings = screen_settings(side, 12.0)
    (form,) = settings.transmit.formats
    named = {layer: getattr(form, layer) or getattr(settings.signal.rate, layer) for layer in LAYERS}
    signal = replace(settings.signal, rate=RateSettings(**named))
    assert {message.data.decode() for message in decode(patterns, signal)} == {"für 12 s"}


def test_packet_takes_at_most_three_seconds_at_ten_patterns_a_second() -> None:
    lasting = [sending_of(b"x", None, side, 10.0).facts()["packet_s"] for side in SIDES]
    assert max(lasting) <= 3.0


@pytest.mark.parametrize("side", SIDES)
def test_file_is_complete_after_any_packets(side: int) -> None:
    data = np.random.default_rng(side).bytes(300)
    made = sending_of(data, "../up/picture.jpg", side, 10.0)
    files, needed = FileGatherer(), made.facts()["packets"]
    whole = [
        progress.whole
        for number in range(5, 5 + 2 * needed)
        for layer in made.transmitter.blocks(number).values()
        for block in layer
        if (progress := files.add(block)) is not None and progress.whole  # type: ignore[arg-type]
    ]
    assert [(one.name, one.data) for one in whole] == [("picture.jpg", data)]


@pytest.mark.parametrize("inverses", [True, False])
def test_no_cell_flashes_more_often_than_the_warning_says(client: TestClient, inverses: bool) -> None:
    facts = client.post(f"/api/transmit?side=8&rate_hz=10&inverses={inverses}", content=b"flashes").json()
    answer = client.get(f"/api/transmit/{facts['sending']}/packets?count=4")
    light = np.frombuffer(answer.content, np.uint8).reshape(-1, 64).astype(int)
    # a flash is a pair of opposing changes of a tenth of full light or more (WCAG 2.3.1): here a level of 4
    changes = [np.sign(steps[steps != 0]) for steps in np.diff(light, axis=0).T]
    flashes = max(1 + np.count_nonzero(np.diff(signs)) for signs in changes) / 2
    assert 3 < flashes * facts["rate_hz"] / len(light) <= facts["rate_hz"] / 2


def test_long_text_is_sent_as_a_file() -> None:
    assert not sending_of(b"x" * 100, None, 16, 10.0).as_file
    assert sending_of(b"x" * 5000, None, 16, 10.0).as_file


@pytest.mark.parametrize(("query", "content", "status"), [
    ("", b"", 400), ("", b"x" * (MAX_BYTES + 1), 400),
    *((query, b"x", 422) for query in ("?side=10", "?side=132", "?rate_hz=0", "?rate_hz=nan", "?rate_hz=1e9")),
    (f"?name={'n' * 500}", b"x", 422),
])  # fmt: skip
def test_invalid_transmissions_are_rejected(client: TestClient, query: str, content: bytes, status: int) -> None:
    answer = client.post(f"/api/transmit{query}", content=content)
    assert answer.status_code == status
    assert answer.json()["error"]


def test_preview_has_a_pattern_and_stores_nothing(client: TestClient) -> None:
    stored = client.app.state.shared.sendings.items()  # type: ignore[attr-defined]
    answer = client.post("/api/transmit?side=20&is_preview=true", content=b"preview").json()
    assert "sending" not in answer
    assert len(answer["pattern"]) == 20 * 20
    assert set(answer["pattern"]) <= set(range(5))
    assert answer["packets"] == 1
    assert client.app.state.shared.sendings.items() == stored  # type: ignore[attr-defined]


def test_phone_gets_an_address_only_from_an_open_server(client: TestClient) -> None:
    assert client.get("/api/transmit/phone").json() == {"url": "", "code": "", "opens": False}
    access, url = Access(LOOPBACK, token="secret"), "http://192.168.1.5:8000/receive#token=secret"
    with TestClient(create_app(access=access, phone_url=url), base_url=OWN) as served:
        assert served.get("/api/transmit/phone").status_code == 401
        answer = served.get("/api/transmit/phone", headers={"authorization": "Bearer secret"}).json()
    assert answer["url"] == url
    assert "<svg" in answer["code"]


def test_packets_need_a_known_transmission(client: TestClient) -> None:
    assert client.get("/api/transmit/nothing/packets").status_code == 404
    name = client.post("/api/transmit", content=b"x").json()["sending"]
    assert client.get(f"/api/transmit/{name}/packets?first=-1").status_code == 422
    assert client.get(f"/api/transmit/{name}/packets?count=99").status_code == 422
    for _ in range(16):
        client.post("/api/transmit", content=b"x")
    assert client.get(f"/api/transmit/{name}/packets").status_code == 404


@pytest.mark.slow
def test_patterns_are_saved_as_a_video_and_leave_no_file(client: TestClient, tmp_path: Path) -> None:
    facts = client.post("/api/transmit?rate_hz=10&side=8", content=b"x").json()
    answer = client.get(f"/api/transmit/{facts['sending']}/film?seconds=6&gamma=1")
    film = tmp_path / "patterns.mp4"
    film.write_bytes(answer.content)
    with open_film(film) as read:
        assert read.rate_hz == pytest.approx(10.0)
        frames = list(read)
    levels = np.frombuffer(client.get(f"/api/transmit/{facts['sending']}/packets").content, np.uint8).reshape(-1, 8, 8)
    middles = (np.arange(8) + sending.MARGIN) * 32 + 16
    seen = np.stack([frame.pixels[np.ix_(middles, middles)].astype(float) for frame in frames[: len(levels)]])
    assert np.abs(seen - levels.astype(float) * (255 / 4)).max() < 6
    assert not list(client.app.state.shared.folder.iterdir())  # type: ignore[attr-defined]


def test_number_of_patterns_and_films_is_limited(client: TestClient) -> None:
    name = client.post("/api/transmit?rate_hz=240", content=b"x").json()["sending"]
    assert client.get(f"/api/transmit/{name}/film?seconds=600").status_code == 400
    assert client.get(f"/api/transmit/{name}/film?seconds=1e9").status_code == 422
    films = client.app.state.shared.pattern_films  # type: ignore[attr-defined]
    with films.take(), films.take():
        assert client.get(f"/api/transmit/{name}/film?seconds=1").status_code == 503
