"""Event output of a running reception: UDP datagrams or a local WebSocket."""

import contextlib
import json
import queue
import re
import socket
import threading
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol
from urllib.parse import urlsplit

from heliograph.base.errors import MediaError, SettingsError, shown

if TYPE_CHECKING:
    from websockets.sync.server import Server, ServerConnection

MOST_DATAGRAM = 65507
"""Largest payload of a UDP datagram over IPv4, in bytes."""

CLOSE_TIMEOUT_S = 2.0
"""Time in s for clients to receive queued rows at the end."""


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

    A client with `max_queued` waiting rows is disconnected.
    """

    def __init__(self, host: str, port: int, max_queued: int = 1000):
        from websockets.sync.server import serve

        self._max_queued = max_queued
        self._queues: dict[ServerConnection, queue.Queue[str | None]] = {}
        self._is_open, self._changed = True, threading.Condition()
        local_pages = re.compile(r"http://(localhost|127\.0\.0\.1|\[::1\])(:\d+)?")
        self._server: Server = serve(self._serve_client, host, port, compression=None, origins=[None, local_pages])
        port = self._server.socket.getsockname()[1]
        self.address = f"ws://{f'[{host}]' if ':' in host else host}:{port}"
        self._thread = threading.Thread(target=self._server.serve_forever, name="websocket", daemon=True)
        self._thread.start()

    def send(self, row: Mapping[str, Any]) -> None:
        """Queue a row for each client; disconnect slow clients with a full queue."""
        text = _line(row).decode()
        with self._changed:
            for client, rows in list(self._queues.items()):
                try:
                    rows.put_nowait(text)
                except queue.Full:
                    del self._queues[client]
                    # unblocks a pending send in the client thread
                    with contextlib.suppress(OSError):
                        client.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Send the queued rows, then stop the server."""
        with self._changed:
            self._is_open, queues = False, list(self._queues.values())
        for rows in queues:
            with contextlib.suppress(queue.Full):
                rows.put(None, timeout=CLOSE_TIMEOUT_S)
        with self._changed:  # shutdown aborts pending sends
            self._changed.wait_for(lambda: not self._queues, CLOSE_TIMEOUT_S)
        ended = threading.Thread(target=self._server.shutdown, daemon=True)
        ended.start()
        ended.join(CLOSE_TIMEOUT_S)
        self._thread.join(CLOSE_TIMEOUT_S)

    def _serve_client(self, client: "ServerConnection") -> None:
        """Send queued rows to a client, in the client thread."""
        from websockets.exceptions import ConnectionClosed

        rows: queue.Queue[str | None] = queue.Queue(self._max_queued)
        with self._changed:
            if not self._is_open:  # a late client would wait for rows forever
                return
            self._queues[client] = rows
        with contextlib.suppress(ConnectionClosed, OSError):
            while client in self._queues and (text := rows.get()) is not None:
                client.send(text)
        with self._changed:
            self._queues.pop(client, None)
            self._changed.notify_all()


def _line(row: Mapping[str, Any]) -> bytes:
    return json.dumps(row).encode()
