"""What a server takes at most: sizes, times, and how much at once."""

from dataclasses import dataclass

MB = 1 << 20

MOST_DIGITS = 18
"""Digits of a length that is looked at; thousands take long to convert."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Bounds of a server; each is chosen to be far above honest use and far below what hurts a laptop."""

    # Most bytes of a film that is uploaded: two minutes of a phone's best video are about 1 GB
    film_bytes: int = 2048 * MB
    # Most uploaded films that are kept; a new one replaces the oldest that nobody reads
    films: int = 8
    # Most bytes of any other request
    body_bytes: int = MB
    # Most bytes of a message of a WebSocket to the server: a raw picture of 2 megapixels
    message_bytes: int = 2 * MB
    # Longest time in s without a byte in the middle of a request
    idle_s: float = 20.0
    # Longest time in s of an upload
    upload_s: float = 1800.0
    # Most uploads at once
    uploads: int = 2
    # Most pages that receive at once, *Watch* and *Receive* together: each takes a core
    sessions: int = 4
    # Most connections at once; more are told to come again
    connections: int = 64
