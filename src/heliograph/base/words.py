"""Words for numbers of things."""


def counted(number: int, thing: str) -> str:
    """A number of things in words.

    Parameters
    ----------
    number
        How many there are, 0 or more.
    thing
        What one of them is called.
    """
    return f"{number} {thing}{'' if number == 1 else 's'}"
