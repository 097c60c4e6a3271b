"""Run the server on a port of this machine, for this machine or, with a token, for others."""

import asyncio
import secrets
import socket
from dataclasses import dataclass
from pathlib import Path

import uvicorn
from fastapi import FastAPI
from uvicorn.protocols.http.h11_impl import H11Protocol

from heliograph.base.errors import SettingsError
from heliograph.web.limits import Limits
from heliograph.web.security import LOOPBACK, Door


def patient_for(seconds: float) -> type[H11Protocol]:
    """Return what speaks HTTP with a client, and lets it go where it does not ask whole.

    uvicorn itself waits for ever for the first request of a connection, and for the rest of one that has begun.
    """

    class Patient(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]  # uvicorn narrows it too
            super().connection_made(transport)
            self.loop.call_later(seconds, self._look)

        def _look(self) -> None:
            # a WebSocket has a protocol of its own
            if self.transport.is_closing() or self.transport.get_protocol() is not self:
                return
            if self.cycle is None or self.cycle.response_complete:
                self.transport.close()
            else:
                self.loop.call_later(seconds, self._look)

    return Patient


@dataclass(frozen=True, slots=True)
class Address:
    """Where a server waits."""

    # host, port: as they were asked for; port 0 takes a free one
    host: str = "127.0.0.1"
    port: int = 8000
    # certificate, key: files of a certificate and its key in PEM, for HTTPS; None for HTTP
    certificate: Path | None = None
    key: Path | None = None

    @property
    def is_own(self) -> bool:
        """Whether this machine alone reaches it."""
        return self.host.lower() in LOOPBACK | {"::1"}

    @property
    def is_secure(self) -> bool:
        """Whether it speaks HTTPS."""
        return self.certificate is not None

    def door(self) -> Door:
        """Who may come in: without a token this machine alone, with a new one whoever has it."""
        if self.is_own:
            return Door()
        names = {self.host.lower(), socket.gethostname().lower(), f"{socket.gethostname().lower()}.local"}
        return Door(LOOPBACK | names, addresses=True, token=secrets.token_urlsafe(16))

    def url(self, port: int, token: str | None) -> str:
        """Return what is opened in a browser; the token stands behind #, which browsers keep to themselves."""
        # hosts that stand for all addresses of this machine
        host = _own_address() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"{'https' if self.is_secure else 'http'}://{host}:{port}/" + (f"#token={token}" if token else "")


def opened(address: Address) -> socket.socket:
    """Open the port."""
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    waiting = socket.socket(family, socket.SOCK_STREAM)
    waiting.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        waiting.bind((address.host, address.port))
        waiting.listen(128)
    except (OSError, OverflowError) as error:
        waiting.close()
        reason = getattr(error, "strerror", None) or str(error)
        raise SettingsError(
            f"cannot wait at {address.host}, port {address.port}: {reason}; choose another one by --port or --host"
        ) from None
    return waiting


def run(app: FastAPI, waiting: socket.socket, address: Address, limits: Limits) -> None:
    """Serve until Ctrl-C."""
    config = configured(app, address, limits)
    try:
        config.load()
    except OSError as error:  # of which those of TLS are kinds
        raise SettingsError(
            f"the certificate {address.certificate} and its key cannot be used: {error.strerror or error}; "
            f"give both in PEM by --certificate and --key"
        ) from None
    uvicorn.Server(config).run(sockets=[waiting])


def configured(app: FastAPI, address: Address, limits: Limits) -> uvicorn.Config:
    """How the server runs."""
    # Longest time in s that the end of the server waits for connections. Chosen
    return uvicorn.Config(
        app,
        log_level="critical",  # of a connection that does not end in time nothing need be said
        access_log=False,
        server_header=False,
        lifespan="on",
        http=patient_for(limits.idle_s),
        ws="websockets-sansio",
        ws_max_size=limits.message_bytes,
        ws_per_message_deflate=False,
        limit_concurrency=limits.connections,
        timeout_keep_alive=5,
        timeout_graceful_shutdown=2,
        ssl_certfile=address.certificate,
        ssl_keyfile=address.key,
    )


def _own_address() -> str:
    """The address by which this machine reaches others; nothing is sent to find it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # RFC 5737: an address of documents, nobody's
            return str(probe.getsockname()[0])
        except OSError:
            return "127.0.0.1"
