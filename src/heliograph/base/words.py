"""Wording for messages."""


def counted(number: int, thing: str) -> str:
    """Return a number with a noun, in the plural unless the number is 1."""
    return f"{number} {thing}{'' if number == 1 else 's'}"
