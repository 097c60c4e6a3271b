"""Limits of a server: sizes, times and numbers."""

from dataclasses import dataclass

MB = 1 << 20

MAX_LENGTH_DIGITS = 18
"""Digits of a length that are parsed; thousands of digits take long to convert."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of a server, far above normal use and far below the capacity of a laptop."""

    # Bytes of an uploaded film: two minutes of high-quality phone video are about 1 GB
    film_bytes: int = 2048 * MB
    # Stored uploads; a new film replaces the oldest film that has no reader
    films: int = 8
    # Bytes of any other request
    body_bytes: int = MB
    # Bytes of a WebSocket message to the server: a raw picture of 2 megapixels
    message_bytes: int = 2 * MB
    # Longest pause in s in the middle of a request
    idle_s: float = 20.0
    # Time in s of an upload
    upload_s: float = 1800.0
    # Concurrent uploads
    uploads: int = 2
    # Concurrent receptions of *Watch* and *Receive*; each uses a core
    sessions: int = 4
    # Concurrent connections
    connections: int = 64
