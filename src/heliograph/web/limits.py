"""Limits of a server: sizes, times and numbers."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of a server, far above normal use and far below the capacity of a laptop."""

    # Bytes of an uploaded film: two minutes of high-quality phone video are about 1 GB
    film_bytes: int = 2048 << 20
    # Stored uploads; a new film replaces the least recently used film
    films: int = 8
    # Bytes of all stored and running uploads
    stored_bytes: int = 4096 << 20
    # Bytes of a WebSocket message to the server: a raw picture of 2 megapixels
    message_bytes: int = 2 << 20
    # Longest pause in s in the middle of a request
    idle_s: float = 20.0
    # Time in s of an upload
    upload_s: float = 1800.0
    # Concurrent uploads
    uploads: int = 2
    # Concurrent receptions of *Watch* and *Receive*; each uses a core
    sessions: int = 4
    # Longest wait in s for the place of an ending reception
    place_s: float = 10.0
    # Concurrent connections
    connections: int = 64
