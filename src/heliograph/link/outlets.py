"""Where news of a reception goes while it runs: datagrams, or a WebSocket of this machine."""

import contextlib
import json
import queue
import re
import socket
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import SplitResult, urlsplit

from heliograph.base.errors import MediaError, SettingsError, shown

if TYPE_CHECKING:
    from websockets.sync.server import Server, ServerConnection

MOST_DATAGRAM = 65507
"""Most bytes of a UDP datagram over IPv4."""

MOST_WAITING = 1000
"""Rows that may wait for a client of the WebSocket; a slower one is let go. Chosen."""

LAST_WORDS_S = 2.0
"""Time in s that clients have at the end to take what waits for them. Chosen."""

OWN_PAGES = re.compile(r"http://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
"""Pages whose scripts may listen at the WebSocket: those of this machine."""

FORMS = "udp://HOST:PORT or ws://127.0.0.1:PORT"
"""Addresses that are known."""


class Outlet(Protocol):
    """Takes rows of plain values while a reception runs."""

    @property
    def address(self) -> str:
        """Where the rows are, for people."""

    def send(self, row: Mapping[str, Any]) -> None:
        """Hand a row on; it never waits for those who take it."""

    def close(self) -> None:
        """End it; what waits is sent within `LAST_WORDS_S`."""


def open_outlet(address: str) -> Outlet:
    """Open a way out."""
    parts = urlsplit(address)
    try:
        port = parts.port
    except ValueError:
        port = None
    if parts.scheme not in ("udp", "ws") or not parts.hostname or port is None or parts.path not in ("", "/"):
        raise SettingsError(f"{shown(address)} is no address to send to: write {FORMS}")
    if parts.scheme == "udp" and port == 0:
        raise SettingsError(f"{shown(address)} names port 0, at which nobody listens: name a port from 1 to 65535")
    try:
        return Datagrams(parts.hostname, port) if parts.scheme == "udp" else _web_socket(parts, port)
    except OSError as error:
        if isinstance(error, MediaError):
            raise
        raise MediaError(f"cannot send to {address}: {error.strerror or error}") from None


class Datagrams:
    """A datagram of UDP for each row; nobody need listen."""

    def __init__(self, host: str, port: int):
        family, kind, protocol, _, there = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._to = there
        self._socket = socket.socket(family, kind, protocol)
        self.address = f"udp://{host}:{port}"

    def send(self, row: Mapping[str, Any]) -> None:
        """Send a row; a longer one than a datagram holds goes without its content; see `Outlet`."""
        text = _line(row)
        if len(text) > MOST_DATAGRAM:
            text = _line({k: v for k, v in row.items() if k not in ("data", "text")} | {"too_long": True})
        with contextlib.suppress(ConnectionRefusedError):  # nobody listened to the one before
            self._socket.sendto(text, self._to)

    def close(self) -> None:
        """Close the socket; see `Outlet`."""
        self._socket.close()


class WebSocket:
    """A server of this machine that sends each row to all who are there; what they send is not read."""

    def __init__(self, host: str, port: int):
        from websockets.sync.server import serve

        self._waiting: dict[ServerConnection, queue.Queue[str | None]] = {}
        self._lock = threading.Lock()
        self._all_gone = threading.Condition(self._lock)
        self._server: Server = serve(self._attend, host, port, compression=None, origins=[None, OWN_PAGES])
        port = self._server.socket.getsockname()[1]
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{port}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="websocket", daemon=True)
        self._thread.start()

    def send(self, row: Mapping[str, Any]) -> None:
        """Put a row into the queue of each client; one whose queue is full is let go; see `Outlet`."""
        text = _line(row).decode()
        with self._lock:
            for client, waiting in list(self._waiting.items()):
                try:
                    waiting.put_nowait(text)
                except queue.Full:
                    del self._waiting[client]
                    # its own thread may be held up in sending: closing the socket frees it
                    with contextlib.suppress(OSError):
                        client.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Let clients take what waits for them, then end; see `Outlet`."""
        with self._lock:
            attended = list(self._waiting.values())
        for waiting in attended:
            with contextlib.suppress(queue.Full):
                waiting.put(None, timeout=LAST_WORDS_S)
        with self._lock:  # shutting down would cut off what is still being sent
            self._all_gone.wait_for(lambda: not self._waiting, LAST_WORDS_S)
        ended = threading.Thread(target=self._server.shutdown, daemon=True)
        ended.start()
        ended.join(LAST_WORDS_S)
        self._thread.join(LAST_WORDS_S)

    def _attend(self, client: "ServerConnection") -> None:
        """Send a client what waits for it, in a thread of its own."""
        from websockets.exceptions import ConnectionClosed

        waiting: queue.Queue[str | None] = queue.Queue(MOST_WAITING)
        with self._lock:
            self._waiting[client] = waiting
        with contextlib.suppress(ConnectionClosed, OSError):
            while (text := waiting.get()) is not None:
                client.send(text)
        with self._lock:
            self._waiting.pop(client, None)
            self._all_gone.notify_all()


def _web_socket(parts: SplitResult, port: int) -> WebSocket:
    # hosts that no other machine reaches
    if parts.hostname not in ("127.0.0.1", "localhost", "::1"):
        raise SettingsError(
            f"a WebSocket is open to this machine alone: write ws://127.0.0.1:{port}, not ws://{parts.hostname}:{port}"
        )
    try:
        return WebSocket(parts.hostname, port)
    except ImportError:
        raise MediaError("a WebSocket takes the library websockets: pip install websockets") from None


def _line(row: Mapping[str, Any]) -> bytes:
    return json.dumps(row).encode()
