"""Access control: host names, origins and tokens of requests, and security headers of responses."""

import hmac
import ipaddress
import re
from base64 import b64encode
from collections.abc import Iterable
from dataclasses import dataclass
from hashlib import sha256

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LOOPBACK = frozenset({"localhost", "127.0.0.1", "[::1]"})  # host names of the loopback interface in browsers

PROTOCOL = "heliograph"
"""WebSocket subprotocol of the pages; a second subprotocol has the token, as browsers cannot set headers."""

DATA = "/api/"  # prefix of paths with data, which require the token; all other paths are static pages

HEADERS = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(self), screen-wake-lock=(self), fullscreen=(self), microphone=(), geolocation=()",
    "cache-control": "no-store",
}
"""Headers of every response. Films may be confidential: browsers store no response."""


def content_policy(host: str) -> str:
    """Return the content security policy: files of this server, generated pictures, no inline scripts, no frames."""
    return (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob:; media-src 'self' blob:; "
        f"font-src 'self'; worker-src 'self'; connect-src 'self' ws://{host} wss://{host}; manifest-src 'self'; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


def inline_policy(page: str) -> str:
    """Return the content security policy of a page in a single file: its own scripts and styles, known by digests."""

    def digests(tag: str) -> str:
        inline = re.findall(rf"<{tag}[^>]*>(.*?)</{tag}>", page, re.DOTALL)
        return " ".join(f"'sha256-{b64encode(sha256(text.encode()).digest()).decode()}'" for text in inline)

    return (
        f"default-src 'none'; script-src {digests('script')}; style-src {digests('style')}; "
        "img-src 'self' blob: data:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )


@dataclass(frozen=True, slots=True)
class Access:
    """Access rules of a server."""

    # Accepted host names in lower case, IPv6 in brackets. Other names may be DNS rebinding by a foreign page
    names: frozenset[str] = LOOPBACK
    # True to accept all numeric addresses, as other machines use; DNS rebinding needs a name
    addresses: bool = False
    # Token for paths below `DATA`; None for free access
    token: str | None = None

    def accepts_host(self, host: str) -> bool:
        """Return True if a Host header names this server."""
        match = re.fullmatch(r"([a-z0-9._-]+|\[[0-9a-f:.]+\])(:[0-9]{1,5})?", host.lower())
        return match is not None and (match[1] in self.names or (self.addresses and _is_address(match[1])))

    def accepts_token(self, tokens: Iterable[str]) -> bool:
        """Return True if a token is valid; the time of the comparison is constant."""
        if self.token is None:
            return True
        expected = self.token.encode()
        return sum(hmac.compare_digest(token.encode(), expected) for token in tokens) > 0


class Guard:
    """Middleware that rejects foreign requests and adds security headers."""

    def __init__(self, app: ASGIApp, access: Access):
        self._app, self._access = app, access

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on or reject the request; see ASGI."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        rejection = self._rejection(scope, headers)
        send = _with_headers(send, "localhost" if rejection else headers["host"])
        if rejection is None:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": rejection[1]})
        else:
            # the rest of the request stays unread: the connection ends
            response = JSONResponse({"error": rejection[1]}, rejection[0], {"connection": "close"})
            await response(scope, receive, send)

    def _rejection(self, scope: Scope, headers: Headers) -> tuple[int, str] | None:
        """Return status and reason if a request is not acceptable."""
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not self._access.accepts_host(hosts[0]):
            return 421, "unknown host name: open the address printed by 'heliograph serve'"
        if _is_foreign(scope, headers):
            return 403, "cross-site requests are not allowed: use the pages of this server"
        if scope["path"].startswith(DATA) and not self._access.accepts_token(_tokens(scope, headers)):
            return 401, "the token is missing or wrong: open the complete address printed by 'heliograph serve'"
        return None


def _is_foreign(scope: Scope, headers: Headers) -> bool:
    """Return True if a browser reports that a page of another site sent the request."""
    scheme = {"ws": "http", "wss": "https"}.get(scope["scheme"], scope["scheme"])
    if any(origin != f"{scheme}://{headers['host']}" for origin in headers.getlist("origin")):
        return True
    # links from other sites may lead to pages, but not to data
    is_page = scope["type"] == "http" and scope["method"] == "GET" and not scope["path"].startswith(DATA)
    is_link = is_page and headers.get("sec-fetch-mode") == "navigate"
    return headers.get("sec-fetch-site", "none") not in ("same-origin", "none") and not is_link


def _tokens(scope: Scope, headers: Headers) -> list[str]:
    """Return the tokens of the Authorization header and of the WebSocket subprotocols."""
    protocols = [name for name in scope.get("subprotocols", ()) if name.startswith("token.")]
    bearers = [value.removeprefix("Bearer ") for value in headers.getlist("authorization")]
    return bearers + [name.removeprefix("token.") for name in protocols]


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return False
    return True


def _with_headers(send: Send, host: str) -> Send:
    """Return `send` that adds `HEADERS` and the content security policy of a host to responses."""

    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            message = {"headers": (), **message}
            headers = MutableHeaders(scope=message)
            headers.update(HEADERS)
            headers.setdefault("content-security-policy", content_policy(host))
        await send(message)

    return send_with_headers
