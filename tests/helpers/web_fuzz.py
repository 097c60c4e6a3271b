"""Fuzz the page server with malformed requests, uploads and socket messages."""

import asyncio
import json
import logging
import random
import tempfile
from collections import Counter
from collections.abc import Awaitable, Iterable, MutableMapping, Sequence
from pathlib import Path
from typing import Any

from fastapi import FastAPI
from fuzz_films import RATE_HZ, film_seeds
from parser_fuzz import mutated

from heliograph.web.app import create_app
from heliograph.web.camera_frames import HEAD
from heliograph.web.crashes import LOG
from heliograph.web.limits import Limits
from heliograph.web.security import LOOPBACK, Access
from heliograph.web.sending import sending_of

LIMITS = Limits(film_bytes=1 << 16, films=4, idle_s=0.05, upload_s=1.0)
"""Small limits, so that cases exceed them."""

LIMIT_S = 20.0
"""Time limit per case; a reception stops before its next frame."""

TOKEN = "a-token"

PATHS = ("/", "/watch", "/api/films", "/api/films/00", "/api/watch/sources", "/api/bundles/00", "/api/transmit",
         "/api/receive", "/assets/watch.js", "/../../etc/passwd", "/%2e%2e/%2e%2e", "/api//films", "/\x00")  # fmt: skip

METHODS = ("GET", "HEAD", "POST", "PUT", "DELETE", "OPTIONS", "PATCH", "BREW")

HEADERS = (
    (b"host", b"127.0.0.1:8000"), (b"host", b"evil.example"), (b"origin", b"http://127.0.0.1:8000"),
    (b"origin", b"null"), (b"authorization", b"Bearer a-token"), (b"authorization", b"Basic AAAA"),
    (b"content-length", b"12"), (b"content-length", b"-1"), (b"content-length", b"999999999999"),
    (b"content-type", b"application/json"), (b"content-type", b"multipart/form-data; boundary="),
    (b"transfer-encoding", b"chunked"), (b"sec-fetch-site", b"cross-site"), (b"range", b"bytes=-9-"),
    (b"cookie", b"a=b"), (b"accept-encoding", b"gzip, br"),
)  # fmt: skip

QUIET = (
    {"do": "pause"}, {"do": "go"}, {"do": "step"}, {"do": "packet"}, {"do": "stop"}, {"do": "save"}, {"do": "took"},
    {"do": "heard", "rows": 7}, {"do": "speed", "times": 0.1}, {"do": "speed", "times": None},
    {"do": "open", "source": {"kind": "film", "film": "0" * 32, "rate_hz": 30.0}},
    {"do": "open", "source": {"kind": "named", "number": 0, "changes": ["signal.side=8", "receive.receiver='soft'"]}},
    {"do": "open", "source": {"kind": "camera", "number": 3}, "paused": True},
)  # fmt: skip
"""Commands that start no reception."""

DRIVE = {"do": "open", "source": {"kind": "drive", "preset": "static", "distance_m": 50.0, "seed": 1, "street": False}}
"""A command that starts a reception."""

WISHES = (
    {"kind": "camera"}, {"kind": "camera", "side": 16, "rate_hz": 10.0}, {"kind": "camera", "side": 8, "rate_hz": None},
    {"kind": "film", "film": "0" * 32},
)  # fmt: skip
"""First messages to page *Receive*."""

SENT = (
    "/api/transmit?side=16&rate_hz=10", "/api/transmit?side=8&rate_hz=30&name=a.jpg", "/api/bundles/{}",
    "/api/transmit/{}/packets?first=7", "/api/transmit/{}/packets?first=0&count=2",
    "/api/transmit/{}/film?seconds=1&gamma=2",
)  # fmt: skip
"""Requests from pages *Transmit* and *Receive*; a name replaces the braces."""

MADE = 0.01
"""Fraction of unmodified film requests; each writes a film."""

FILMS = ("h5", "mkv", "mp4", "npy", "cine", "tif", "y4m")
"""Film formats to damage."""

FILM_PART = 0.05
"""Fraction of film cases, which are the slowest."""

DRIVES = 0.002
"""Fraction of messages made from `DRIVE`, which is slow."""


def served() -> FastAPI:
    """Return an application with a token and a missing film."""
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


async def talk(
    app: FastAPI,
    messages: Iterable[MutableMapping[str, Any]],
    token: str = TOKEN,
    to_the_end: bool = False,
    path: str = "/api/watch",
) -> list[str]:
    """Send messages to the page WebSocket; return the replies: events, "bytes", or the close code.

    The client disconnects at once, or at the end of its reception.
    """
    scope = {
        "type": "websocket", "asgi": {"version": "3.0"}, "http_version": "1.1", "scheme": "ws", "path": path,
        "raw_path": path.encode(), "root_path": "", "query_string": b"", "headers": [(b"host", b"127.0.0.1:8000")],
        "client": ("127.0.0.1", 1), "server": ("127.0.0.1", 8000), "subprotocols": ["heliograph", f"token.{token}"],
    }  # fmt: skip
    waiting, said, over = [{"type": "websocket.connect"}, *messages], [], asyncio.Event()

    async def receive() -> MutableMapping[str, Any]:
        if not waiting and to_the_end:
            await over.wait()
        return waiting.pop(0) if waiting else {"type": "websocket.disconnect", "code": 1001}

    async def send(message: MutableMapping[str, Any]) -> None:
        kind = message["type"].removeprefix("websocket.")
        event = json.loads(message["text"])["event"] if "text" in message else kind
        said.append(f"close {message.get('code')}" if kind == "close" else event)
        if event in ("end", "failed", "refused"):
            over.set()

    await asyncio.wait_for(app(scope, receive, send), LIMIT_S)
    return said


def request_case(rng: random.Random) -> tuple[str, str, list[tuple[bytes, bytes]], list[bytes | None]]:
    """Draw a request; half of the cases are uploads."""
    if rng.random() < 0.5:
        method, path = "PUT", f"/api/films?kind={rng.choice(('mp4', 'npy', '../../x', '', 'h5%00'))}"
        headers = [HEADERS[0], HEADERS[4]]
    else:
        method, path = rng.choice(METHODS), rng.choice(PATHS)
        headers = [(b"host", b"127.0.0.1:8000")] if rng.random() < 0.9 else []
        headers += [HEADERS[4]] if rng.random() < 0.7 else []
    if rng.random() < 0.5:
        path = mutated(path.encode(), rng).decode("utf-8", "replace") or "/"
        path = path if path.startswith("/") else f"/{path}"
    for name, value in rng.sample(HEADERS, rng.choice((0, 0, 1, 2))):
        headers.append((name, mutated(value, rng) if rng.random() < 0.5 else value))
    parts: list[bytes | None] = [rng.randbytes(int(2 ** rng.uniform(0, 11))) for _ in range(rng.randrange(5))]
    if rng.random() < 0.02:
        parts.append(None)
    return method, path, headers, parts


def message_case(rng: random.Random) -> MutableMapping[str, Any]:
    """Draw a command message, usually mutated, as text or bytes."""
    command = DRIVE if rng.random() < DRIVES else rng.choice(QUIET)
    data = json.dumps(command).encode()
    if rng.random() < 0.85:
        data = mutated(data, rng)
    if rng.random() < 0.1:
        return {"type": "websocket.receive", "bytes": data}
    return {"type": "websocket.receive", "text": data.decode("utf-8", rng.choice(("replace", "surrogateescape")))}


async def fuzz_requests(app: FastAPI, cases: int, rng: random.Random) -> Counter[str]:
    """Count outcomes of requests by first status digit, or by fault."""
    found: Counter[str] = Counter()
    for _ in range(cases):
        case = request_case(rng)
        try:
            status = await answer(app, *case)
            found[f"{status // 100}xx" if 200 <= status < 500 or status == 503 else f"{status} of {case[:2]}"] += 1
        except Exception as error:
            found[f"{type(error).__name__}: {error} of {case[:3]}"[:300]] += 1
    return found


async def fuzz_messages(app: FastAPI, cases: int, rng: random.Random) -> Counter[str]:
    """Count outcomes of conversations per message: ended, let go, or a fault."""
    found: Counter[str] = Counter()
    while found.total() < cases:
        messages = [message_case(rng) for _ in range(min(rng.randrange(1, 30), cases - found.total()))]
        try:
            said = await talk(app, messages, TOKEN if rng.random() < 0.98 else "wrong")
            found["let go" if any(one.startswith("close") for one in said) else "ended"] += len(messages)
        except Exception as error:
            found[f"{type(error).__name__}: {error} of {messages[-1]}"[:300]] += len(messages)
    return found


def sent_case(rng: random.Random, name: str) -> tuple[str, str, bytes]:
    """Draw a request for page *Transmit* or *Receive*, usually mutated: method, path, body."""
    path = rng.choice(SENT).replace("{}", name)
    if rng.random() < (1 - MADE if "film" in path else 0.7):
        path = mutated(path.encode(), rng).decode("utf-8", "replace")
    path = path if path.startswith("/") else f"/{path}"
    return rng.choice(("POST", "GET")), path, rng.randbytes(int(2 ** rng.uniform(0, 9)))


def camera_case(rng: random.Random, number: int) -> MutableMapping[str, Any]:
    """Draw a browser camera frame, sometimes mutated, or a text command."""
    if rng.random() < 0.1:
        return {"type": "websocket.receive", "text": rng.choice(("save", "end", "halt", ""))}
    data = HEAD.pack(number / 30, number, 64, 48) + rng.randbytes(64 * 48)
    return {"type": "websocket.receive", "bytes": mutated(data, rng) if rng.random() < 0.3 else data}


async def fuzz_screen(app: FastAPI, cases: int, rng: random.Random) -> Counter[str]:
    """Count outcomes of requests and conversations on pages *Transmit* and *Receive*."""
    found: Counter[str] = Counter()
    headers = [HEADERS[0], HEADERS[4]]
    name = app.state.shared.sendings.add(sending_of(b"a text", None, 8, 60.0))
    case: Awaitable[int | list[str]]
    while found.total() < cases:
        if rng.random() < 0.3:
            method, path, body = sent_case(rng, name)
            case, count = answer(app, method, path, [*headers, (b"content-length", b"%d" % len(body))], [body]), 1
        else:
            count = min(rng.randrange(1, 12), cases - found.total())
            wish = json.dumps(rng.choice(WISHES)).encode()
            path = (mutated(wish, rng) if rng.random() < 0.5 else wish).decode("utf-8", "replace")
            messages = [{"type": "websocket.receive", "text": path}, *(camera_case(rng, k) for k in range(count - 1))]
            case = talk(app, messages, path="/api/receive")
        try:
            became = await case
            if isinstance(became, list):
                found["let go" if any(one.startswith("close") for one in became) else "ended"] += count
            else:
                good = 200 <= became < 500 or became == 503
                found[f"{became // 100}xx" if good else f"{became} of {path}"] += count
        except Exception as error:
            found[f"{type(error).__name__}: {error} of {path}"[:300]] += count
    return found


async def fuzz_films(app: FastAPI, cases: int, rng: random.Random) -> Counter[str]:
    """Count outcomes of damaged, uploaded and watched films: "end", "failed", or a fault."""
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        good = [(kind, data) for kind in FILMS for data in film_seeds(Path(folder), "{}")[f"film.{kind}"][1]]
    headers = [HEADERS[0], HEADERS[4]]
    for _ in range(cases):
        kind, data = rng.choice(good)
        changed = mutated(data, rng) or b"0"
        status = await answer(app, "PUT", f"/api/films?kind={kind}", headers, [changed])
        if status != 201:
            found[f"{status // 100}xx"] += 1
            continue
        name = [*app.state.shared.uploads.items()][-1]
        source = {"kind": "film", "film": name, "rate_hz": RATE_HZ if kind in ("npy", "tif") else None}
        opens = {"type": "websocket.receive", "text": json.dumps({"do": "open", "source": source})}
        try:
            said = await talk(app, [opens], to_the_end=True)
            found[next((one for one in said if one in ("end", "failed")), f"{said} of a {kind}")] += 1
        except Exception as error:
            found[f"{type(error).__name__}: {error} of a {kind}"[:300]] += 1
    return found


class Crashes(logging.Handler):
    """Count the tracebacks that the server logs: pages learn of a crash in the same way as of a damaged film."""

    def __init__(self) -> None:
        super().__init__(logging.ERROR)
        self.found: Counter[str] = Counter()

    def emit(self, record: logging.LogRecord) -> None:
        self.found[record.getMessage()[:300]] += 1


async def fuzz(cases: int, seed: int) -> dict[str, Counter[str]]:
    """Run cases with requests, messages and damaged films; fail on crashes, and on leftovers from aborted cases."""
    app, films = served(), round(cases * FILM_PART)
    part = (cases - films) // 3
    crashes = Crashes()
    LOG.addHandler(crashes)
    async with app.router.lifespan_context(app):
        found = {
            "requests": await fuzz_requests(app, part, random.Random(f"requests {seed}")),
            "messages": await fuzz_messages(app, cases - films - 2 * part, random.Random(f"messages {seed}")),
            "screen": await fuzz_screen(app, part, random.Random(f"screen {seed}")),
            "films": await fuzz_films(app, films, random.Random(f"films {seed}")),
        }
        shared = app.state.shared
        kept = {film.path for film in [*shared.uploads.items().values(), *shared.bundles.items().values()]}
        left = [path for path in shared.folder.iterdir() if path not in kept]
        many = len(kept) > LIMITS.films + 2 * LIMITS.sessions
        if left or many or shared.sessions.taken:
            found["left over"] = Counter({f"{len(left)} files, {app.state.shared.sessions.taken} sessions": 1})
    LOG.removeHandler(crashes)
    return {**found, "crashes": crashes.found}


GOOD = ("2xx", "3xx", "4xx", "5xx", "ended", "let go", "end", "failed")
"""Valid outcomes; 5xx is 503, server full."""
