"""Who may come in: the page's own browser, by the names of this machine, with the token where one is asked for."""

import asyncio
import hmac
import ipaddress
import json
import re
from collections.abc import Awaitable, Callable, Iterable, MutableMapping
from dataclasses import dataclass
from typing import Any

from heliograph.web.limits import MOST_DIGITS, Limits

Scope = MutableMapping[str, Any]
Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

LOOPBACK = frozenset({"localhost", "127.0.0.1", "[::1]"})
"""Names of this machine for itself, as a browser writes them."""

HOST = re.compile(r"(?P<name>[a-z0-9._-]+|\[[0-9a-f:.]+\])(:[0-9]{1,5})?")
"""A Host header: a name or an address, IPv6 in brackets, and a port."""

PROTOCOL = "heliograph"
"""What a WebSocket of the pages speaks; a browser cannot send a header with it, so the token is offered beside it."""

TOKEN_PROTOCOL = "token."

DATA = "/api/"
"""Paths below it hold data and ask for the token; all others are the package's own pages."""

HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(self), screen-wake-lock=(self), fullscreen=(self), microphone=(), geolocation=()",
    "cache-control": "no-store",
}
"""Sent with every answer. Nothing is kept: what is shown may be nobody else's business, and the pages are small."""


def content_policy(host: str) -> str:
    """Return the content security policy: own files and generated pictures only, no inline script, no embedding."""
    return (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; media-src 'self' blob:; "
        f"font-src 'self'; worker-src 'self'; connect-src 'self' ws://{host} wss://{host}; manifest-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


@dataclass(frozen=True, slots=True)
class Door:
    """Who may come in."""

    # Hosts by which the server is asked, in lower case, IPv6 in brackets. A page elsewhere whose name was made to lead
    # here (DNS rebinding) asks by its own name, and is refused
    names: frozenset[str] = LOOPBACK
    # Whether any address in digits will do as well: other machines ask by it, and no name can lead to it
    addresses: bool = False
    # What data is given for; None asks for none
    token: str | None = None

    def knows(self, host: str) -> bool:
        """Whether a Host header is one of this server's."""
        found = HOST.fullmatch(host.lower())
        name = found["name"] if found else ""
        return name in self.names or (self.addresses and _is_address(name))

    def lets_in(self, offered: Iterable[str]) -> bool:
        """Whether one of the tokens that were offered is the right one; it takes as long whatever they are."""
        if self.token is None:
            return True
        known = self.token.encode()
        return sum(hmac.compare_digest(one.encode(), known) for one in offered) > 0


class Guard:
    """Stands before the application: refuses what does not come from its own pages, and bounds what comes in."""

    def __init__(self, app: App, door: Door, limits: Limits):
        self._app, self._door, self._limits = app, door, limits

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request in, or answer it; see ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = _headers(scope)
        host = headers.get("host", [""])[0]
        refused = self._refusal(scope, headers, host)
        answer = _dressed(send, content_policy(host) if refused is None else content_policy("localhost"))
        if refused is not None:
            await _refuse(scope, answer, *refused)
        elif scope["type"] == "http":
            await self._app(scope, _patient(receive, self._limits.idle_s), answer)
        else:
            await self._app(scope, receive, send)

    def _refusal(self, scope: Scope, headers: dict[str, list[str]], host: str) -> tuple[int, str] | None:
        """Status and reason where a request is refused."""
        if len(headers.get("host", [])) != 1 or not self._door.knows(host):
            return 421, "this server is not asked by that name: take the address that 'heliograph serve' printed"
        if _is_foreign(scope, headers, host):
            return 403, "only the pages of this server may ask for that"
        if scope["path"].startswith(DATA) and not self._door.lets_in(_tokens(scope, headers)):
            return 401, "the token is missing or wrong: open the whole address that 'heliograph serve' printed"
        # method of uploads, which count their bytes themselves
        if scope["type"] == "http" and scope["method"] not in ("GET", "HEAD", "PUT"):
            return self._too_long(headers)
        return None

    def _too_long(self, headers: dict[str, list[str]]) -> tuple[int, str] | None:
        length = headers.get("content-length", ["0" if "transfer-encoding" not in headers else ""])[0]
        if not (length.isascii() and length.isdecimal()):
            return 411, "the length of a request must be said"
        if len(length) > MOST_DIGITS or int(length) > self._limits.body_bytes:
            return 413, f"a request has at most {self._limits.body_bytes} bytes"
        return None


def _is_foreign(scope: Scope, headers: dict[str, list[str]], host: str) -> bool:
    """Whether a browser says that another site's page asks; only browsers can be talked into asking for others."""
    own = {"ws": "http", "wss": "https"}.get(scope["scheme"], scope["scheme"])
    if any(origin != f"{own}://{host}" for origin in headers.get("origin", [])):
        return True
    site, mode = headers.get("sec-fetch-site", ["none"])[0], headers.get("sec-fetch-mode", [""])[0]
    # a link to a page may be followed from anywhere
    followed = mode == "navigate" and scope["type"] == "http" and scope["method"] == "GET"
    return site not in ("same-origin", "none") and not (followed and not scope["path"].startswith(DATA))


def _tokens(scope: Scope, headers: dict[str, list[str]]) -> list[str]:
    """What is offered for a token: by a header, or beside the protocol of a WebSocket."""
    offered = [one.removeprefix("Bearer ") for one in headers.get("authorization", [])]
    protocols = scope.get("subprotocols", ())
    return offered + [one.removeprefix(TOKEN_PROTOCOL) for one in protocols if one.startswith(TOKEN_PROTOCOL)]


def _headers(scope: Scope) -> dict[str, list[str]]:
    out: dict[str, list[str]] = {}
    for key, value in scope["headers"]:
        out.setdefault(key.decode("latin-1").lower(), []).append(value.decode("latin-1"))
    return out


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def _patient(receive: Receive, idle_s: float) -> Receive:
    """Take parts of a body as they come; where none comes for too long, whoever sends is taken to be gone."""
    whole = False

    async def next_part() -> Message:
        nonlocal whole
        if whole:
            return await receive()
        try:
            part = await asyncio.wait_for(receive(), idle_s)
        except TimeoutError:
            return {"type": "http.disconnect"}
        whole = not part.get("more_body", False)
        return part

    return next_part


def _dressed(send: Send, policy: str) -> Send:
    """Send answers with `HEADERS` and a content policy."""
    extra = [(key.encode(), value.encode()) for key, value in (HEADERS | {"content-security-policy": policy}).items()]

    async def send_dressed(message: Message) -> None:
        if message["type"] == "http.response.start":
            own = {key for key, _ in extra}
            kept = [(key, value) for key, value in message.get("headers", ()) if key.lower() not in own]
            message = {**message, "headers": [*kept, *extra]}
        await send(message)

    return send_dressed


async def _refuse(scope: Scope, send: Send, status: int, reason: str) -> None:
    if scope["type"] == "websocket":
        await send({"type": "websocket.close", "code": 1008, "reason": reason})
        return
    body = json.dumps({"error": reason}).encode()
    # what is still on its way is not read: the connection ends
    headers = [(b"content-type", b"application/json"), (b"connection", b"close")]
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": body})
