"""Errors for the user: a line with the problem and the remedy."""

import unicodedata
from collections.abc import Callable
from numbers import Number

MOST_SHOWN = 80
"""Most characters of a wrong value in a message."""

UNDECODED = range(0xDC80, 0xDD00)
"""Characters that stand for the bytes of a file name that is not UTF-8 (PEP 383)."""

JOINERS = "\u200c\u200d"
"""Characters within words of some scripts and within emoji."""


class HeliographError(Exception):
    """Misuse or broken input; the message states the rule and the wrong value on one line.

    Parameters
    ----------
    message
        Text; characters that a terminal cannot print, such as a line break in a file name, are escaped.
    """

    def __init__(self, message: object = ""):
        super().__init__(printable(str(message)))


class SettingsError(HeliographError, ValueError):
    """A setting is unknown, has the wrong type or is out of range."""


class MediaError(HeliographError, OSError):
    """A film or data file is missing, damaged, of an unknown form, or cannot be written."""


def printable(text: str) -> str:
    r"""Escape all characters that a terminal or a UTF-8 file cannot show; a byte that is not UTF-8 becomes ``\xe9``."""
    return text if text.isprintable() else "".join(map(_escape, text))


def _escape(character: str) -> str:
    if character.isprintable() or character in JOINERS or unicodedata.category(character) == "Zs":
        return character
    if ord(character) in UNDECODED:
        return f"\\x{ord(character) & 0xFF:02x}"
    return character.encode("unicode_escape").decode("ascii")


def brief(value: object) -> str:
    """Return the text of an error, a text or a wrong value on one line, cut to `MOST_SHOWN` characters."""
    return _on_a_line(str if isinstance(value, (str, Exception)) else repr, value)


def shown(value: object) -> str:
    """Return a wrong argument on one line: a number or text as Python writes it, else the type."""
    return _on_a_line(repr, value) if isinstance(value, (str, Number)) else type(value).__name__


def _on_a_line(write: Callable[[object], str], value: object) -> str:
    try:
        text = " ".join(write(value).split())
    except ValueError:  # a number of more digits than Python writes
        return "a number of thousands of digits"
    return text if len(text) <= MOST_SHOWN else f"{text[: MOST_SHOWN - 3]}..."
