import asyncio
from collections.abc import Iterator
from typing import Any

import pytest
from fastapi.testclient import TestClient
from web_fuzz import GOOD, answer, fuzz, served
from web_server import OWN

from heliograph.web.app import create_app
from heliograph.web.security import LOOPBACK, Access
from heliograph.web.shared import Limits
from heliograph.web.stores import MissingError, Store


@pytest.fixture
def fresh() -> Iterator[TestClient]:
    """Client of a new server with small limits."""
    with TestClient(create_app(limits=Limits(film_bytes=1000, films=2)), base_url=OWN) as made:
        yield made


@pytest.mark.parametrize("page", ["", "watch", "transmit", "receive", "replay", "watch.html", "icon.svg"])
def test_pages_have_a_strict_content_policy(client: TestClient, page: str) -> None:
    answer = client.get(f"/{page}")
    assert answer.status_code == 200
    policy = answer.headers["content-security-policy"]
    assert {"default-src 'none'", "frame-ancestors 'none'"} <= set(policy.split("; "))
    assert "unsafe" not in policy
    assert answer.headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize(
    "path", ["/nowhere", "/../../pyproject.toml", "/%2e%2e/__init__.py", "/assets", "/docs", "/openapi.json"]
)
def test_other_paths_are_not_found(client: TestClient, path: str) -> None:
    assert client.get(path).status_code == 404


FOREIGN = ["evil.example", "evil.example:8000", "127.0.0.1.evil.example", "", "192.168.1.5", "[::2]",
           "127.0.0.1:80; script-src *", "127.0.0.1:", "[::1"]  # fmt: skip


@pytest.mark.parametrize("host", ["localhost:8000", "LOCALHOST", "127.0.0.1", "[::1]:8000", *FOREIGN])
def test_only_own_host_names_are_accepted(client: TestClient, host: str) -> None:
    assert client.get("/", headers={"host": host}).status_code == (421 if host in FOREIGN else 200)


@pytest.mark.parametrize("headers", [
    {"origin": "https://evil.example"}, {"origin": "null"}, {"origin": "http://127.0.0.1:9000"},
    {"origin": "https://127.0.0.1:8000"}, {"sec-fetch-site": "cross-site", "sec-fetch-mode": "cors"},
    {"sec-fetch-site": "same-site", "sec-fetch-mode": "no-cors"},
    {"sec-fetch-site": "cross-site", "sec-fetch-mode": "navigate"},
])  # fmt: skip
def test_requests_of_other_sites_are_rejected(client: TestClient, headers: dict[str, str]) -> None:
    assert client.put("/api/films", content=b"film", headers=headers).status_code == 403
    assert client.get("/api/films", headers=headers).status_code == 403
    is_link = headers.get("sec-fetch-mode") == "navigate"
    assert client.get("/watch", headers=headers).status_code == (200 if is_link else 403)


def test_data_requires_the_token_and_pages_do_not() -> None:
    access = Access(LOOPBACK, addresses=True, token="right")
    with TestClient(create_app(access=access), base_url="http://192.168.1.5:8000") as client:
        assert (client.get("/watch").status_code, client.put("/api/films", content=b"film").status_code) == (200, 401)
        for token, status in (("wrong", 401), ("right", 201)):
            headers = {"authorization": f"Bearer {token}"}
            assert client.put("/api/films", content=b"film", headers=headers).status_code == status


def test_uploads_have_random_names_and_stay_while_they_are_read(fresh: TestClient) -> None:
    name = fresh.put("/api/films?kind=../../x", content=b"film").json()["film"]
    shared = fresh.app.state.shared  # type: ignore[attr-defined]
    with shared.uploads.of(name).reading() as path:
        assert (path.parent, path.suffix, path.read_bytes()) == (shared.folder, "", b"film")
        fresh.delete(f"/api/films/{name}")
        assert path.exists()
    assert not path.exists()
    assert fresh.delete(f"/api/films/{name}").status_code == 204


def test_new_uploads_replace_the_oldest(fresh: TestClient) -> None:
    contents = [b"first", b"second", b"third"]
    for content in contents:
        fresh.put("/api/films?kind=MP4", content=content)
    paths = list(fresh.app.state.shared.folder.iterdir())  # type: ignore[attr-defined]
    assert (sorted(path.read_bytes() for path in paths), {path.suffix for path in paths}) == (contents[1:], {".mp4"})


def test_size_of_all_uploads_is_limited() -> None:
    with TestClient(create_app(limits=Limits(film_bytes=1000, stored_bytes=2000)), base_url=OWN) as client:
        contents = [bytes([k]) * 900 for k in range(3)]
        for content in contents:
            assert client.put("/api/films", content=content).status_code == 201
        folder = client.app.state.shared.folder  # type: ignore[attr-defined]
        assert sorted(path.read_bytes() for path in folder.iterdir()) == contents[1:]


@pytest.mark.parametrize(("content", "status", "reason"), [
    (b"", 400, "empty"), (bytes(1001), 413, "a film has"), (iter([bytes(600)] * 2), 413, "a film has"),
])  # fmt: skip
def test_empty_and_large_uploads_leave_no_file(fresh: TestClient, content: Any, status: int, reason: str) -> None:
    answer = fresh.put("/api/films", content=content)
    assert answer.status_code == status
    assert reason in answer.json()["error"]
    assert not list(fresh.app.state.shared.folder.iterdir())  # type: ignore[attr-defined]


@pytest.mark.parametrize("length", ["-1", "1e3", "", "0x10", "9" * 5000])
def test_invalid_lengths_are_rejected(fresh: TestClient, length: str) -> None:
    assert fresh.put("/api/films", headers={"content-length": length}).status_code == 422


def test_films_are_deleted_when_the_server_ends() -> None:
    with TestClient(create_app(), base_url=OWN) as client:
        client.put("/api/films", content=b"film")
        folder = client.app.state.shared.folder  # type: ignore[attr-defined]
        assert list(folder.iterdir())
    assert not folder.exists()


def test_growing_values_discard_older_values() -> None:
    discarded = list[bytes]()
    store = Store[bytearray](9, "gone", lambda value: discarded.append(bytes(value)), 10, len)
    first, second = bytearray(b"12345"), bytearray(b"1")
    keys = [store.add(value) for value in (first, second)]
    second += b"23456"  # as in an upload
    store.trim()
    assert discarded == [first]
    second += bytes(20)
    store.trim()
    assert store.of(keys[1]) is second


def test_full_store_discards_the_least_recently_used_value() -> None:
    discarded = list[int]()
    store = Store[int](2, "gone", discarded.append)
    keys = [store.add(value) for value in (1, 2)]
    assert store.of(keys[0]) == 1
    store.add(3)
    store.drop("unknown")
    assert discarded == [2]
    with pytest.raises(MissingError, match="gone"):
        store.of(keys[1])


@pytest.mark.slow
@pytest.mark.usefixtures("quick_ends")
def test_malformed_requests_and_messages_have_valid_outcomes() -> None:
    found = asyncio.run(fuzz(requests=140, conversations=40, seed=3))
    assert set(found) <= GOOD
    assert found.total() == 180


def test_interrupted_upload_is_reported() -> None:
    headers = [(b"host", b"127.0.0.1:8000"), (b"authorization", b"Bearer a-token"), (b"content-length", b"12")]
    assert asyncio.run(answer(served(), "POST", "/api/transmit", headers, [b"a te", None])) == 400
