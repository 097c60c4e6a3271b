"""Connections of clients: those that ask for nothing are let go, so that they take nobody's place."""

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol


def patient_for(seconds: float) -> type[H11Protocol]:
    """Return what speaks HTTP with a client, and lets it go where it does not ask whole.

    uvicorn itself waits for ever for the first request of a connection, and for the rest of one that has begun.
    """

    class Patient(H11Protocol):
        def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
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
