"""Fuzz the page server with malformed requests, uploads and socket messages."""

import asyncio
import json
import logging
import random
from collections import Counter
from collections.abc import Iterable, MutableMapping, Sequence
from typing import Any

from fastapi import FastAPI
from parser_fuzz import mutated

from heliograph.web.app import create_app
from heliograph.web.camera_frames import HEAD
from heliograph.web.crashes import LOG
from heliograph.web.security import LOOPBACK, Access
from heliograph.web.sending import sending_of
from heliograph.web.shared import Limits

LIMITS = Limits(film_bytes=1 << 16, films=4, idle_s=0.05, upload_s=1.0)  # small limits, so that cases exceed them
LIMIT_S = 20.0  # time limit per case; a reception stops before its next frame
TOKEN = "a-token"
PATHS = ("/", "/watch", "/api/films", "/api/films/00", "/api/watch/sources", "/api/bundles/00", "/api/transmit",
         "/api/receive", "/assets/watch.js", "/../../etc/passwd", "/%2e%2e/%2e%2e", "/api//films", "/\x00",
         "/api/transmit?side=16&rate_hz=10", "/api/transmit?side=8&rate_hz=30&name=a.jpg",
         "/api/transmit/{}/packets?first=0&count=2", "/api/transmit/{}/film?seconds=1e9")  # fmt: skip
"""Paths of requests; the key of a transmission replaces the braces."""
METHODS = ("GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH", "BREW")
HEADERS = (
    (b"host", b"127.0.0.1:8000"), (b"host", b"evil.example"), (b"origin", b"http://127.0.0.1:8000"),
    (b"origin", b"null"), (b"authorization", b"Bearer a-token"), (b"authorization", b"Basic AAAA"),
    (b"content-length", b"12"), (b"content-length", b"-1"), (b"content-length", b"999999999999"),
    (b"content-type", b"application/json"), (b"content-type", b"multipart/form-data; boundary="),
    (b"transfer-encoding", b"chunked"), (b"sec-fetch-site", b"cross-site"), (b"range", b"bytes=-9-"),
    (b"cookie", b"a=b"), (b"accept-encoding", b"gzip, br"),
)  # fmt: skip
COMMANDS = (
    {"do": "pause"}, {"do": "go"}, {"do": "step"}, {"do": "packet"}, {"do": "stop"}, {"do": "save"}, {"do": "took"},
    {"do": "heard", "rows": 7}, {"do": "speed", "times": 0.1}, {"do": "speed", "times": None},
    {"do": "open", "source": {"kind": "film", "film": "0" * 32, "rate_hz": 30.0}},
    {"do": "open", "source": {"kind": "named", "number": 0, "changes": ["signal.side=8", "receive.receiver='soft'"]}},
    {"do": "open", "source": {"kind": "camera", "number": 3}, "paused": True},
)  # fmt: skip
"""Commands of page *Watch* that start no reception."""
RECEPTIONS = (
    {"kind": "camera"}, {"kind": "camera", "side": 16, "rate_hz": 10.0}, {"kind": "camera", "side": 8, "rate_hz": None},
    {"kind": "film", "film": "0" * 32},
)  # fmt: skip
"""First messages of page *Receive*."""


def served() -> FastAPI:
    return create_app(films=["missing.mkv"], access=Access(LOOPBACK, token=TOKEN), limits=LIMITS)


async def answer(
    app: FastAPI, method: str, path: str, headers: Iterable[tuple[bytes, bytes]], parts: Sequence[bytes | None]
) -> int:
    """Return the status, or -1 if unanswered; a None part never arrives."""
    scope = {
        "type": "http", "asgi": {"version": "3.0"}, "http_version": "1.1", "method": method, "scheme": "http",
        "path": path.partition("?")[0], "raw_path": path.encode("utf-8", "replace"), "root_path": "",
        "query_string": path.partition("?")[2].encode("utf-8", "replace"), "headers": list(headers),
        "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 8000),
    }  # fmt: skip
    waiting, status = [*parts], -1

    async def receive() -> MutableMapping[str, Any]:
        if not waiting:
            return {"type": "http.disconnect"}
        part = waiting.pop(0)
        if part is None:
            await asyncio.sleep(3600)
        return {"type": "http.request", "body": part, "more_body": bool(waiting)}

    async def send(message: MutableMapping[str, Any]) -> None:
        nonlocal status
        status = message.get("status", status)

    await asyncio.wait_for(app(scope, receive, send), LIMIT_S)
    return status


async def talk(app: FastAPI, path: str, messages: Iterable[MutableMapping[str, Any]], token: str = TOKEN) -> bool:
    """Send messages to a WebSocket and disconnect; return True if the server closed the connection."""
    scope = {
        "type": "websocket", "asgi": {"version": "3.0"}, "http_version": "1.1", "scheme": "ws", "path": path,
        "raw_path": path.encode(), "root_path": "", "query_string": b"", "headers": [(b"host", b"127.0.0.1:8000")],
        "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 8000), "subprotocols": ["heliograph", f"token.{token}"],
    }  # fmt: skip
    waiting, is_closed = [{"type": "websocket.connect"}, *messages], False

    async def receive() -> MutableMapping[str, Any]:
        return waiting.pop(0) if waiting else {"type": "websocket.disconnect", "code": 1001}

    async def send(message: MutableMapping[str, Any]) -> None:
        nonlocal is_closed
        is_closed |= message["type"] == "websocket.close"

    await asyncio.wait_for(app(scope, receive, send), LIMIT_S)
    return is_closed


def request_case(rng: random.Random, key: str) -> tuple[str, str, list[tuple[bytes, bytes]], list[bytes | None]]:
    """Draw a request; half of the cases are uploads."""
    if rng.random() < 0.5:
        method, path = "PUT", f"/api/films?kind={rng.choice(('mp4', 'npy', '../../x', '', 'h5%00'))}"
        headers = [HEADERS[0], HEADERS[4]]
    else:
        method, path = rng.choice(METHODS), rng.choice(PATHS).replace("{}", key)
        headers = [HEADERS[0]] if rng.random() < 0.9 else []
        headers += [HEADERS[4]] if rng.random() < 0.7 else []
    if rng.random() < 0.5:
        path = f"/{mutated(path.encode(), rng).decode('utf-8', 'replace').removeprefix('/')}"
    for name, value in rng.sample(HEADERS, rng.choice((0, 0, 1, 2))):
        headers.append((name, mutated(value, rng) if rng.random() < 0.5 else value))
    parts: list[bytes | None] = [rng.randbytes(int(2 ** rng.uniform(0, 11))) for _ in range(rng.randrange(5))]
    if rng.random() < 0.02:
        parts.append(None)
    return method, path, headers, parts


def text_message(rng: random.Random, value: object, mutation: float) -> MutableMapping[str, Any]:
    """Return a message in JSON, mutated with a probability, as text or bytes."""
    data = json.dumps(value).encode()
    if rng.random() < mutation:
        data = mutated(data, rng)
    if rng.random() < 0.1:
        return {"type": "websocket.receive", "bytes": data}
    return {"type": "websocket.receive", "text": data.decode("utf-8", rng.choice(("replace", "surrogateescape")))}


def camera_message(rng: random.Random, number: int) -> MutableMapping[str, Any]:
    """Draw a browser camera frame, sometimes mutated, or a text command."""
    if rng.random() < 0.1:
        return {"type": "websocket.receive", "text": rng.choice(("save", "end", "halt", ""))}
    data = HEAD.pack(number / 30, number, 64, 48) + rng.randbytes(64 * 48)
    return {"type": "websocket.receive", "bytes": mutated(data, rng) if rng.random() < 0.3 else data}


def conversation(rng: random.Random) -> tuple[str, list[MutableMapping[str, Any]]]:
    count = rng.randrange(1, 20)
    if rng.random() < 0.5:
        return "/api/watch", [text_message(rng, rng.choice(COMMANDS), 0.85) for _ in range(count)]
    first = text_message(rng, rng.choice(RECEPTIONS), 0.5)
    return "/api/receive", [first, *(camera_message(rng, number) for number in range(count))]


class Crashes(logging.Handler):
    """Count the tracebacks that the server logs: pages learn of a crash in the same way as of a damaged film."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.found: Counter[str] = Counter()

    def emit(self, record: logging.LogRecord) -> None:
        self.found[record.getMessage()[:300]] += 1


async def fuzz(requests: int, conversations: int, seed: int) -> Counter[str]:
    """Count outcomes: the first digit of a status, the end of a conversation, crashes, and leftovers."""
    app, rng, crashes = served(), random.Random(seed), Crashes()
    found = crashes.found
    LOG.addHandler(crashes)
    async with app.router.lifespan_context(app):
        shared = app.state.shared
        key = shared.sendings.add(sending_of(b"a text", None, 8, 60.0))
        for _ in range(requests):
            case = request_case(rng, key)
            status = await answer(app, *case)
            is_valid = 200 <= status < 500 or status == 503
            found[f"{status // 100}xx" if is_valid else f"{status} of {case[:2]}"] += 1
        for _ in range(conversations):
            path, messages = conversation(rng)
            is_closed = await talk(app, path, messages, TOKEN if rng.random() < 0.98 else "wrong")
            found["closed" if is_closed else "ended"] += 1
        kept = {film.path for film in [*shared.uploads.items().values(), *shared.bundles.items().values()]}
        left = [path for path in shared.folder.iterdir() if path not in kept]
        if left or len(kept) > LIMITS.films + 2 * LIMITS.sessions or shared.sessions.taken:
            found[f"{len(left)} files, {shared.sessions.taken} sessions left"] += 1
    LOG.removeHandler(crashes)
    return found


GOOD = {"2xx", "3xx", "4xx", "5xx", "ended", "closed"}  # valid outcomes; 5xx is 503, server full
