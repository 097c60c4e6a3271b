"""Event output of a running reception: UDP datagrams or a local WebSocket."""

import asyncio
import contextlib
import json
import re
import socket
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import urlsplit

from heliograph.base.errors import MediaError, SettingsError, shown

if TYPE_CHECKING:
    from websockets.asyncio.server import Server

MOST_DATAGRAM = 65507  # largest payload of a UDP datagram over IPv4, in bytes
CLOSE_TIMEOUT_S = 2.0  # time in s for clients to receive queued rows at the end


class Outlet(Protocol):
    """Sink for rows of plain values."""

    @property
    def address(self) -> str:
        """Address for display."""

    def send(self, row: Mapping[str, Any]) -> None:
        """Send a row; never blocks."""

    def close(self) -> None:
        """Close the sink; queued rows are sent within `CLOSE_TIMEOUT_S`."""


def open_outlet(address: str) -> Outlet:
    """Open a sink for an address."""
    parts = urlsplit(address)
    try:
        port = parts.port
    except ValueError:
        port = None
    if parts.scheme not in ("udp", "ws") or not parts.hostname or port is None or parts.path not in ("", "/"):
        raise SettingsError(f"{shown(address)} is no address to send to: write udp://HOST:PORT or ws://127.0.0.1:PORT")
    if parts.scheme == "udp" and port == 0:
        raise SettingsError(f"{shown(address)} names port 0, which has no listener: name a port from 1 to 65535")
    if parts.scheme == "ws" and parts.hostname not in ("127.0.0.1", "localhost", "::1"):
        raise SettingsError(
            f"a WebSocket is only for this machine: write ws://127.0.0.1:{port}, not ws://{parts.hostname}:{port}"
        )
    try:
        return Datagrams(parts.hostname, port) if parts.scheme == "udp" else WebSocket(parts.hostname, port)
    except ImportError:
        raise MediaError("a WebSocket needs the library websockets: pip install websockets") from None
    except OSError as error:
        raise MediaError(f"cannot send to {address}: {error.strerror or error}") from None


class Datagrams:
    """UDP sink, a datagram for each row; a listener is optional."""

    def __init__(self, host: str, port: int):
        family, kind, protocol, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        self._to = address
        self.address = f"udp://{host}:{port}"

    def send(self, row: Mapping[str, Any]) -> None:
        """Send a row; drop the content if the row exceeds a datagram."""
        text = _line(row)
        if len(text) > MOST_DATAGRAM:
            text = _line({k: v for k, v in row.items() if k not in ("data", "text")} | {"too_long": True})
        with contextlib.suppress(ConnectionRefusedError):  # the previous datagram had no listener
            self._socket.sendto(text, self._to)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class WebSocket:
    """Local WebSocket server that sends each row to all clients; input from clients is ignored.

    A client with more than `max_waiting` bytes of waiting rows is disconnected.
    """

    def __init__(self, host: str, port: int, max_waiting: int = 1 << 26):
        self._max_waiting = max_waiting
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="websocket", daemon=True)
        self._thread.start()
        try:
            self._server = asyncio.run_coroutine_threadsafe(self._serve(host, port), self._loop).result()
        except BaseException:
            self._stop()
            raise
        port = self._server.sockets[0].getsockname()[1]
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{port}"

    async def _serve(self, host: str, port: int) -> "Server":
        from websockets.asyncio.server import serve

        local_pages = re.compile(r"http://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
        return await serve(
            lambda client: client.wait_closed(), host, port, compression=None, origins=[None, local_pages],
            close_timeout=CLOSE_TIMEOUT_S,
        )  # fmt: skip

    def send(self, row: Mapping[str, Any]) -> None:
        """Queue a row for each client; disconnect slow clients."""
        self._loop.call_soon_threadsafe(self._broadcast, _line(row).decode())

    def _broadcast(self, text: str) -> None:
        from websockets.asyncio.server import broadcast

        for client in self._server.connections:
            if client.transport.get_write_buffer_size() > self._max_waiting:
                client.transport.abort()
        broadcast(self._server.connections, text)

    def close(self) -> None:
        """Send the queued rows, then stop the server."""
        self._loop.call_soon_threadsafe(self._server.close)
        with contextlib.suppress(TimeoutError):
            asyncio.run_coroutine_threadsafe(self._server.wait_closed(), self._loop).result(2 * CLOSE_TIMEOUT_S)
        self._stop()

    def _stop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


def _line(row: Mapping[str, Any]) -> bytes:
    return json.dumps(row).encode()
