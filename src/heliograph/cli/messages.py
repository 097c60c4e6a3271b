"""Messages and files to send, from the options of a command."""

import contextlib
import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path

from heliograph.base.config import from_mapping
from heliograph.base.errors import MediaError, SettingsError, shown
from heliograph.base.files import read_bounded
from heliograph.cli.options import SentOptions, read_toml
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import DEFAULT_TEXTS
from heliograph.road.codec import mapem, updates
from heliograph.road.junction import Junction
from heliograph.signal.block import MAX_MESSAGE
from heliograph.signal.fountain.codes import CODES
from heliograph.signal.fountain.files import SentFile
from heliograph.signal.message import Updates
from heliograph.signal.settings import LAYERS
from heliograph.transmit import Messages
from heliograph.transmit.transmitter import Content

STDIN, TEXT = "-", "text:"
"""Argument for standard input, and prefix of a text that looks like a file name."""

TOO_LONG = "send less, or split it"


def read_messages(settings: LinkSettings, sent: SentOptions, seconds: float) -> list[Messages]:
    """Return the content of each array for some seconds; by default, the default messages."""
    options = {"high": sent.high, "middle": sent.middle, "low": sent.low}
    texts = {layer: text for layer, text in options.items() if text is not None}
    if list(texts.values()).count(STDIN) > 1:
        raise MediaError("a single layer can send standard input: give - once")
    files = [file_of(path, sent.file_code) for path in sent.file or ()]
    content: dict[str, Sequence[Content]] = {layer: [message_of(layer, text)] for layer, text in texts.items()}
    content.update(_road_messages(sent, seconds))
    if files and len(content) == len(LAYERS):
        raise MediaError("--file needs a layer that has no message: leave out --high, --middle or --low")
    if files:
        content = dict.fromkeys(LAYERS, files) | content
    content = content or {layer: [text.encode()] for layer, text in DEFAULT_TEXTS.items()}
    return [content for _ in settings.transmit.identities]


def _road_messages(sent: SentOptions, seconds: float) -> Messages:
    """Return the traffic lights of a junction for the high layer, and the map for the middle layer."""
    if sent.junction is None:
        return {}
    if sent.high is not None or sent.middle is not None:
        raise MediaError("--junction uses the high and the middle layer: leave out --high and --middle")
    tree = read_toml(sent.junction)
    try:
        junction = from_mapping(Junction, tree)
    except SettingsError as error:
        raise SettingsError(f"{sent.junction}: {error}") from None
    return {"high": [Updates(updates(junction, seconds))], "middle": [mapem(junction)]}


def file_of(path: Path, code: str) -> SentFile:
    """Return a file for fountain coding with the file name."""
    names = {name: name for name in CODES}
    if code not in names:
        raise MediaError(f"--file-code is one of {', '.join(names)}, not {shown(code)}")
    # names travel as text: bytes that are not UTF-8 are replaced
    name = re.sub("[\ud800-\udfff]", "_", path.name)
    try:
        return SentFile(name, read_bounded(path, MAX_MESSAGE, TOO_LONG), names[code])
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from None


def message_of(layer: str, argument: str) -> bytes:
    """Return the message of an argument: "-", "text:" with a text, a file name, or a text."""
    path, source = Path(argument), argument
    is_text = not argument or argument.startswith(TEXT) or not (_is_file_name(argument) or _exists(path))
    if argument == STDIN:
        data, source = sys.stdin.buffer.read(MAX_MESSAGE + 1), "standard input"
    elif is_text:
        data, source = os.fsencode(argument.removeprefix(TEXT)), f"the text of --{layer}"
    else:
        try:
            data = read_bounded(path, MAX_MESSAGE, TOO_LONG)
        except OSError as error:
            hint = f"; to send these words write --{layer} {TEXT}..." if not _exists(path) else ""
            raise MediaError(f"cannot read {path}: {error.strerror}{hint}") from None
    if len(data) > MAX_MESSAGE:
        raise MediaError(f"{source} has more than {MAX_MESSAGE} bytes: {TOO_LONG}")
    if not data:
        raise MediaError(f"{source} is empty: there is no message to send")
    return data


def _is_file_name(argument: str) -> bool:
    """Return True for text with a folder or suffix and no blanks."""
    return bool(re.fullmatch(r"\S*[/\\]\S*|\S+\.[A-Za-z][A-Za-z0-9]{0,4}", argument))


def _exists(path: Path) -> bool:
    with contextlib.suppress(OSError, ValueError):  # texts may be too long for a name, or contain a null character
        return path.exists()
    return False
