"""Web server on a port, for this machine or, with a token, for other machines."""

import asyncio
import secrets
import socket
import threading
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from heliograph.base.errors import SettingsError
from heliograph.web.recorded_drive import warm_up
from heliograph.web.security import LOOPBACK, Access
from heliograph.web.shared import Limits


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
    """Serve until Ctrl-C, and compile the receiver meanwhile."""
    config = server_config(app, address, limits)
    try:
        config.load()
    except OSError as error:  # includes ssl.SSLError
        raise SettingsError(
            f"cannot use the certificate {address.certificate} and its key: {error.strerror or error}; "
            f"give both in PEM by --certificate and --key"
        ) from None
    threading.Thread(target=warm_up, daemon=True).start()
    uvicorn.Server(config).run(sockets=[listener])


def server_config(app: FastAPI, address: Address, limits: Limits) -> uvicorn.Config:
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
