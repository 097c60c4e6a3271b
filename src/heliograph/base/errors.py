"""Errors for the user: a line with the problem and the remedy."""

import unicodedata
from numbers import Number


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
    # the two joiners are part of words of some scripts and of emoji
    if character.isprintable() or character in "\u200c\u200d" or unicodedata.category(character) == "Zs":
        return character
    if "\udc80" <= character <= "\udcff":  # a byte that is not UTF-8 (PEP 383)
        return f"\\x{ord(character) & 0xFF:02x}"
    return character.encode("unicode_escape").decode("ascii")


def brief(value: object) -> str:
    """Return the text of an error, a text or a wrong value on one line, cut to 80 characters."""
    try:
        text = " ".join((str if isinstance(value, (str, Exception)) else repr)(value).split())
    except ValueError:  # a number of more digits than Python writes
        return "a number of thousands of digits"
    return text if len(text) <= 80 else f"{text[:77]}..."


def shown(value: object) -> str:
    """Return a wrong argument on one line: a number or text as Python writes it, else the type."""
    written = repr(value) if isinstance(value, str) else value
    return brief(written) if isinstance(value, (str, Number)) else type(value).__name__
