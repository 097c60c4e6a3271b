"""What happens in a reception, told while it runs: on standard output, on standard error, by datagram or WebSocket."""

import contextlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from heliograph.cli import console

if TYPE_CHECKING:
    from heliograph.link.outlets import Outlet


@dataclass(frozen=True, slots=True)
class Told:
    """Where news go: options of the command, as they were given."""

    follow: bool = False
    verbose: bool = False
    send: tuple[str, ...] = ()


class News:
    """Hands rows to all who asked for them; an outlet that fails is told once and left out, the others go on."""

    def __init__(self, told: Told):
        self._told = told
        self._outlets: list[Outlet] = []
        self._open = contextlib.ExitStack()

    def __enter__(self) -> "News":
        from heliograph.link.outlets import open_outlet

        with contextlib.ExitStack() as undo:
            for address in self._told.send:
                outlet = open_outlet(address)
                undo.callback(outlet.close)
                self._outlets.append(outlet)
                console.complain(f"news are sent to {outlet.address}")
            self._open = undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def tell(self, row: Mapping[str, Any]) -> None:
        """Hand a row on."""
        if self._told.follow:
            console.say_json(row)
        if self._told.verbose and row["event"] != "end":
            from heliograph.measure.journal import sentence

            for line in sentence(row).splitlines():
                console.tell(line)
        for outlet in list(self._outlets):
            try:
                outlet.send(row)
            except OSError as error:
                self._outlets.remove(outlet)
                console.complain(f"nothing more is sent to {outlet.address}: {error.strerror or error}")
