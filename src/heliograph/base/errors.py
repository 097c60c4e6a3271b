"""Errors for the user: one line that says what is wrong and how to mend it."""


class HeliographError(Exception):
    """Misuse or broken input; the message is one line that states the rule and the value that breaks it."""


class SettingsError(HeliographError, ValueError):
    """A setting is unknown, has the wrong type or is out of range."""


class MediaError(HeliographError, OSError):
    """A film or data file is missing, damaged, of an unknown form, or cannot be written."""
