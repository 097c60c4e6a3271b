"""User-facing errors, a line with the problem and the remedy, and wording for messages."""

import unicodedata
from numbers import Number


class HeliographError(Exception):
    """Misuse or broken input; the message states the rule and the wrong value on a single line, and is printable."""

    def __init__(self, message: object = ""):
        super().__init__(printable(str(message)))


class SettingsError(HeliographError, ValueError):
    """A setting is unknown, has the wrong type or is out of range."""


class MediaError(HeliographError, OSError):
    """A film or data file is missing, damaged, in an unknown format, or cannot be written."""


def printable(text: str) -> str:
    r"""Escape characters that a terminal or a UTF-8 file cannot show; an invalid UTF-8 byte becomes ``\xe9``."""
    return text if text.isprintable() else "".join(map(_escape, text))


def _escape(character: str) -> str:
    # some scripts and emoji contain the two joiners
    if character.isprintable() or character in "\u200c\u200d" or unicodedata.category(character) == "Zs":
        return character
    if "\udc80" <= character <= "\udcff":  # invalid UTF-8 byte (PEP 383)
        return f"\\x{ord(character) & 0xFF:02x}"
    return character.encode("unicode_escape").decode("ascii")


def brief(value: object) -> str:
    """Return an error or a wrong value as text on a single line, cut to 80 characters."""
    try:
        text = " ".join((str if isinstance(value, (str, Exception)) else repr)(value).split())
    except ValueError:  # more digits than Python prints
        return "a number of thousands of digits"
    return text if len(text) <= 80 else f"{text[:77]}..."


def counted(number: int, thing: str) -> str:
    """Return a number with a noun, in the plural unless the number is 1."""
    return f"{number} {thing}{'' if number == 1 else 's'}"


def shown(value: object) -> str:
    """Return a wrong argument on a single line: numbers and text as in Python source, otherwise the type."""
    written = repr(value) if isinstance(value, str) else value
    return brief(written) if isinstance(value, (str, Number)) else type(value).__name__
