"""Errors meant to be read by a user: one line that says what is wrong and how to mend it."""


class HeliographError(Exception):
    """Misuse or broken input; the message is one line, states the rule and the value met."""


class SettingsError(HeliographError, ValueError):
    """A setting is unknown, of the wrong type or out of range."""


class MediaError(HeliographError, OSError):
    """A film or data file is missing, damaged or of an unknown form."""
