"""Errors for the user: one line that says what is wrong and how to mend it."""

from numbers import Number

_SHOWN = 60
"""Most characters of a wrong value in a message."""


class HeliographError(Exception):
    """Misuse or broken input; the message is one line that states the rule and the value that breaks it."""


class SettingsError(HeliographError, ValueError):
    """A setting is unknown, has the wrong type or is out of range."""


class MediaError(HeliographError, OSError):
    """A film or data file is missing, damaged, of an unknown form, or cannot be written."""


def shown(value: object) -> str:
    """Return what was given for something else, on a line of an error: a number or text as it is, else its type.

    Parameters
    ----------
    value
        What was given; an array, say, would fill many lines.
    """
    if not isinstance(value, (str, Number)):
        return type(value).__name__
    try:
        text = " ".join(repr(value).split())
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 3]}..."
