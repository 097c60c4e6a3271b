from collections.abc import Iterator

import pytest
from fastapi.testclient import TestClient

from heliograph.web.app import create_app
from heliograph.web.limits import Limits
from heliograph.web.security import LOOPBACK, Access

OWN = "http://127.0.0.1:8000"
SMALL = Limits(film_bytes=1000, films=2, body_bytes=100)


@pytest.fixture
def client() -> Iterator[TestClient]:
    with TestClient(create_app(limits=SMALL), base_url=OWN) as made:
        yield made


@pytest.fixture
def guarded() -> Iterator[TestClient]:
    access = Access(LOOPBACK, addresses=True, token="right")
    with TestClient(create_app(access=access, limits=SMALL), base_url="http://192.168.1.5:8000") as made:
        yield made


@pytest.mark.parametrize("page", ["", "watch", "transmit", "receive", "watch.html", "icon.svg"])
def test_pages_come_with_a_strict_policy(client: TestClient, page: str) -> None:
    answer = client.get(f"/{page}")
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "frame-ancestors 'none'" in policy
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    "path", ["/nowhere", "/../../pyproject.toml", "/%2e%2e/__init__.py", "/assets", "/docs", "/openapi.json"]
)
def test_nothing_else_is_served(client: TestClient, path: str) -> None:
    assert client.get(path).status_code == 404


@pytest.mark.parametrize(
    "host",
    [
        "evil.example",
        "evil.example:8000",
        "127.0.0.1.evil.example",
        "",
        "192.168.1.5",
        "[::2]",
        "127.0.0.1:80; script-src *",
        "127.0.0.1:",
        "[::1",
    ],
)
def test_other_names_for_this_machine_are_refused(client: TestClient, host: str) -> None:
    assert client.get("/", headers={"host": host}).status_code == 421


@pytest.mark.parametrize("host", ["localhost:8000", "LOCALHOST", "127.0.0.1", "[::1]:8000"])
def test_own_names_are_taken(client: TestClient, host: str) -> None:
    assert client.get("/", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "https://evil.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9000"},
        {"origin": "https://127.0.0.1:8000"},
        {"sec-fetch-site": "cross-site", "sec-fetch-mode": "cors"},
        {"sec-fetch-site": "same-site", "sec-fetch-mode": "no-cors"},
        {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"},
    ],
)
def test_requests_of_other_sites_are_refused(client: TestClient, headers: dict[str, str]) -> None:
    assert client.put("/api/films", content=b"film", headers=headers).status_code == 403
    assert client.get("/api/films", headers=headers).status_code == 403


def test_a_link_from_elsewhere_may_be_followed_to_a_page(client: TestClient) -> None:
    followed = {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"}
    assert client.get("/watch", headers=followed).status_code == 200


def test_data_takes_the_token_and_pages_do_not(guarded: TestClient) -> None:
    assert guarded.get("/watch").status_code == 200
    assert guarded.put("/api/films", content=b"film").status_code == 401
    assert guarded.put("/api/films", content=b"film", headers={"authorization": "Bearer wrong"}).status_code == 401
    assert guarded.put("/api/films", content=b"film", headers={"authorization": "Bearer right"}).status_code == 201


def test_an_upload_is_kept_under_a_name_of_the_servers_own(client: TestClient) -> None:
    name = client.put("/api/films?kind=../../x", content=b"film").json()["film"]
    uploads = client.app.state.shared.uploads  # type: ignore[attr-defined]
    with uploads.reading(name) as path:
        assert path.name == name
        assert path.parent == uploads.folder()
        assert path.read_bytes() == b"film"
        client.delete(f"/api/films/{name}")
        assert path.exists()  # still in use by a reader
    client.delete(f"/api/films/{name}")
    assert not path.exists()


def test_the_oldest_upload_makes_room(client: TestClient) -> None:
    names = [client.put("/api/films?kind=MP4", content=b"film").json()["film"] for _ in range(3)]
    folder = client.app.state.shared.uploads.folder()  # type: ignore[attr-defined]
    assert sorted(path.name for path in folder.iterdir()) == sorted(f"{name}.mp4" for name in names[1:])


@pytest.mark.parametrize(("content", "status"), [(b"", 400), (bytes(1001), 413)])
def test_uploads_without_or_with_too_much_content_leave_nothing(
    client: TestClient, content: bytes, status: int
) -> None:
    answer = client.put("/api/films", content=content)
    assert answer.status_code == status
    assert "a film has" in answer.json()["error"] or "empty" in answer.json()["error"]
    assert not list(client.app.state.shared.uploads.folder().iterdir())  # type: ignore[attr-defined]


def test_other_requests_are_short(client: TestClient) -> None:
    assert client.post("/api/films", content=bytes(101)).status_code == 413
    assert client.post("/api/films", content=iter([b"of no said length"])).status_code == 411


@pytest.mark.parametrize("length", ["-1", "1e3", "", "+5", "0x10"])
def test_a_length_that_is_none_is_refused(client: TestClient, length: str) -> None:
    assert client.post("/api/films", headers={"content-length": length}).status_code == 411


def test_a_length_of_thousands_of_digits_is_refused(client: TestClient) -> None:
    assert client.post("/api/films", headers={"content-length": "9" * 5000}).status_code == 413


def test_films_are_gone_when_the_server_ends() -> None:
    with TestClient(create_app(limits=SMALL), base_url=OWN) as client:
        client.put("/api/films", content=b"film")
        folder = client.app.state.shared.uploads.folder()  # type: ignore[attr-defined]
        assert folder.exists()
    assert not folder.exists()
