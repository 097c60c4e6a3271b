"""SPATEM and MAPEM as UPER, by the package `pycrate` (extra `its`)."""

import threading
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from heliograph.base.errors import SettingsError

SPATEM, MAPEM = 4, 5
"""Numbers of the messages in their header (ETSI TS 102 894-2)."""

NAMES = {SPATEM: "SPATEM", MAPEM: "MAPEM"}

VERSION = 1
"""Version of the header that is written."""

VERSIONS = (1, 2)
"""Versions that are read: the messages of both are alike."""

HEADER_BYTES = 6
"""Bytes of the header: version, message, station."""

MOST_BYTES = 8192
"""Most bytes of a message that is read. Chosen: a MAPEM of 100 lanes has about 3000."""

_LOCK = threading.Lock()
"""The package keeps the value that it last coded in its types: one thread at a time."""


class UnreadableError(ValueError):
    """A message cannot be read; the text says why, in a line."""


def kind_of(data: bytes) -> str | None:
    """Return "SPATEM" or "MAPEM" by a message's header; None of another one."""
    if len(data) <= HEADER_BYTES or data[0] not in VERSIONS:
        return None
    return NAMES.get(data[1])


def is_there() -> bool:
    """Whether the package `pycrate` is installed."""
    try:
        _type(SPATEM)
    except SettingsError:
        return False
    return True


def packed(message: int, station: int, content: Mapping[str, Any]) -> bytes:
    """Return a message as UPER."""
    header = {"protocolVersion": VERSION, "messageID": message, "stationID": station}
    with _LOCK:
        kind = _type(message)
        kind.set_val({"header": header, "spat" if message == SPATEM else "map": dict(content)})
        return bytes(kind.to_uper())


def unpacked(data: bytes) -> tuple[str, int, dict[str, Any]]:
    """Return a message's kind, the number of its station, and what it says, as the package has it."""
    kind = kind_of(data)
    if kind is None:
        raise UnreadableError("it is no SPATEM or MAPEM")
    if len(data) > MOST_BYTES:
        raise UnreadableError(f"this {kind} has {len(data)} bytes, more than {MOST_BYTES}")
    with _LOCK:
        try:
            coded = _type(data[1])
            coded.from_uper(data)
            value: dict[str, Any] = coded.get_val()
            coded.set_val(value)
            same = bytes(coded.to_uper()) == data
        except SettingsError as error:
            raise UnreadableError(str(error)) from None
        except Exception:  # the package raises what its parts raise: IndexError, KeyError, its own
            raise UnreadableError(f"this {kind} is damaged: it is not as ISO TS 19091 has it") from None
    if not same:
        raise UnreadableError(f"this {kind} is damaged: there is one way to write what it says, and it is another")
    return kind, int(value["header"]["stationID"]), value["spat" if kind == "SPATEM" else "map"]


@lru_cache(maxsize=2)
def _type(message: int) -> Any:
    try:
        from pycrate_asn1dir import ITS_IS
    except ImportError:
        raise SettingsError("messages of the road need the package pycrate: pip install 'heliograph[its]'") from None
    return ITS_IS.SPATEM_PDU_Descriptions.SPATEM if message == SPATEM else ITS_IS.MAPEM_PDU_Descriptions.MAPEM
