"""Messages in the words of the pages, which have fields in place of options and settings."""

import re
from collections.abc import Sequence

FIELDS: tuple[tuple[str, str], ...] = (
    (r" \(rate_hz[^)]*\)", ""),
    (r"(by |with )--fps( RATE)?", r"\1the field Frame rate"),
    (r"--receiver (\w+)", r"the receiver \1"),
    (r"by 'heliograph transmit'", "by page Transmit"),
    (r": name (the film|it) on the command line", r": start the server with \1"),
    (r"the address printed by 'heliograph serve'", "the address that the server printed"),
)
"""Advice of commands, and the same advice for pages."""

COMMANDS = re.compile(
    r"(?<![\w-])--[a-z-]+|'heliograph [a-z]+'|command line|\b(?:signal|receive|channel|transmit)\.[a-z_0-9.]{2,}"
)
"""Options, commands and keys of settings."""


def page_words(message: str, typed: Sequence[str] = ()) -> str:
    """Return a message without advice on commands, options and settings, except settings that the user has typed.

    Messages are a problem and then remedies, separated by colons, semicolons and commas.
    """
    for pattern, words in FIELDS:
        message = re.sub(pattern, words, message)
    if any(key and key in message for key in (text.partition("=")[0].strip() for text in typed)):
        return message
    first, *rest = re.split(r"([:;,] )", message)
    advice = zip(rest[::2], rest[1::2], strict=True)
    problem = COMMANDS.sub(lambda match: match[0].rpartition(".")[2].strip("-'").replace("_", " "), first)
    return problem + "".join(mark + part for mark, part in advice if not COMMANDS.search(part))
