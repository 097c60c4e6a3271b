"""Web server on a port, for this machine or, with a token, for other machines."""

import asyncio
import secrets
import socket
from dataclasses import dataclass, replace
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from heliograph.base.errors import SettingsError
from heliograph.web.app import guarded_app
from heliograph.web.recorded_drive import start_warm_up
from heliograph.web.security import LOOPBACK, Access
from heliograph.web.shared import Limits, Shared


def http_protocol(idle_s: float) -> type[H11Protocol]:
    """Return an HTTP protocol that closes idle connections; uvicorn waits indefinitely for incomplete requests."""

    class IdleTimeoutProtocol(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # as in uvicorn
            super().connection_made(transport)
            self.loop.call_later(idle_s, self._check_activity)

        def _check_activity(self) -> None:
            # a WebSocket replaces the protocol of the connection
            if self.transport.is_closing() or self.transport.get_protocol() is not self:
                return
            if self.cycle is None or self.cycle.response_complete:
                self.transport.close()
            else:
                self.loop.call_later(idle_s, self._check_activity)

    return IdleTimeoutProtocol


@dataclass(frozen=True, slots=True)
class Address:
    """Address of a server."""

    host: str = "127.0.0.1"
    # Port number; 0 for a free port
    port: int = 8000
    # certificate, key: PEM files for HTTPS; None for HTTP
    certificate: Path | None = None
    key: Path | None = None

    @property
    def is_loopback(self) -> bool:
        """True if only this machine reaches the server."""
        return self.host.lower() in LOOPBACK | {"::1"}

    @property
    def is_secure(self) -> bool:
        """True for HTTPS."""
        return self.certificate is not None

    def access(self) -> Access:
        """Return access rules: free access on this machine, a new token for other machines."""
        if self.is_loopback:
            return Access()
        names = {self.host.lower(), socket.gethostname().lower(), f"{socket.gethostname().lower()}.local"}
        return Access(LOOPBACK | names, addresses=True, token=secrets.token_urlsafe(16))

    def url(self, port: int, token: str | None, page: str = "") -> str:
        """Return the URL of a page; browsers do not send the token after #."""
        # wildcard addresses stand for all addresses of this machine
        host = _local_address() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"{'https' if self.is_secure else 'http'}://{host}:{port}/{page}" + (f"#token={token}" if token else "")


def open_port(address: Address) -> socket.socket:
    """Return a listening socket."""
    listener = socket.socket(socket.AF_INET6 if ":" in address.host else socket.AF_INET, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    place = f"{address.host}, port {address.port}"
    try:
        listener.bind((address.host, address.port))
        listener.listen(128)
    except (OSError, OverflowError) as error:
        listener.close()
        reason = getattr(error, "strerror", None) or str(error)
        raise SettingsError(f"cannot listen at {place}: {reason}; choose another address by --port or --host") from None
    return listener


def run(app: FastAPI, listener: socket.socket, address: Address, limits: Limits) -> None:
    """Serve until Ctrl-C, and warm up the receiver meanwhile."""
    server = make_server(app, listener, address, limits)
    try:
        server.config.load()
    except OSError as error:  # includes ssl.SSLError
        raise SettingsError(
            f"cannot use the certificate {address.certificate} and its key: {error.strerror or error}; "
            f"give both in PEM by --certificate and --key"
        ) from None
    start_warm_up(app.state.shared.is_compiled)
    server.run(sockets=[listener])


def make_server(app: FastAPI, listener: socket.socket, address: Address, limits: Limits) -> uvicorn.Server:
    """Create a server; a server for this machine can open to the network."""
    if address.is_loopback:
        app.state.network = Network(app.state.shared, replace(address, port=listener.getsockname()[1]), limits)
    return uvicorn.Server(_config(app, address, limits))


class Network:
    """Listener for other machines, with the same port and a new token each time."""

    def __init__(self, shared: Shared, address: Address, limits: Limits):
        self._shared, self._address, self._limits, self._lock = shared, address, limits, asyncio.Lock()
        self._running: tuple[uvicorn.Server, asyncio.Task[None]] | None = None

    async def open(self) -> None:
        """Listen at the address of this machine in the local network."""
        async with self._lock:
            if self._running is not None:
                return
            address = replace(self._address, host=_local_address())
            if address.is_loopback:
                raise SettingsError("this machine has no network address: connect to a network, then try again")
            access = address.access()
            listener = open_port(address)
            server = uvicorn.Server(_config(guarded_app(self._shared, access), address, self._limits))
            self._running = server, asyncio.create_task(server.serve(sockets=[listener]))
            self._shared.phone_url = address.url(address.port, access.token, "receive")

    async def close(self) -> None:
        """Stop listening, and disconnect other machines."""
        async with self._lock:
            if self._running is not None:
                (server, task), self._running = self._running, None
                self._shared.phone_url = ""
                server.should_exit = True
                await task


def _config(app: FastAPI, address: Address, limits: Limits) -> uvicorn.Config:
    """Return the configuration of uvicorn."""
    return uvicorn.Config(
        app,
        log_level="critical",  # hides errors of connections that outlast the server
        access_log=False,
        server_header=False,
        lifespan="on",
        http=http_protocol(limits.idle_s),
        ws="websockets-sansio",
        ws_max_size=limits.message_bytes,
        ws_per_message_deflate=False,
        limit_concurrency=limits.connections,
        timeout_keep_alive=5,
        timeout_graceful_shutdown=2,
        ssl_certfile=address.certificate,
        ssl_keyfile=address.key,
    )


def _local_address() -> str:
    """Return the address of this machine in the local network; no packet is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # documentation address (RFC 5737)
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"
