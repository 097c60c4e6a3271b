"""What a server takes at most: sizes, times, and how much at once."""

from dataclasses import dataclass

MB = 1 << 20

MOST_DIGITS = 18
"""Digits of a length that is looked at; thousands take long to convert."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Bounds of a server; each is chosen to be far above honest use and far below what hurts a laptop.

    Attributes
    ----------
    film_bytes
        Most bytes of a film that is uploaded: two minutes of a phone's best video are about 1 GB.
    films
        Most uploaded films that are kept; a new one replaces the oldest that nobody reads.
    body_bytes
        Most bytes of any other request.
    message_bytes
        Most bytes of a message of a WebSocket to the server: a raw picture of 2 megapixels.
    idle_s
        Longest time in s without a byte in the middle of a request.
    upload_s
        Longest time in s of an upload.
    uploads
        Most uploads at once.
    sessions
        Most pages that receive at once, *Watch* and *Receive* together: each takes a core.
    connections
        Most connections at once; more are told to come again.
    """

    film_bytes: int = 2048 * MB
    films: int = 8
    body_bytes: int = MB
    message_bytes: int = 2 * MB
    idle_s: float = 20.0
    upload_s: float = 1800.0
    uploads: int = 2
    sessions: int = 4
    connections: int = 64
