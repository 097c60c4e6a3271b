"""Make docs/settings.md from the settings classes: `python scripts/make_settings.py`, or `make settings`."""

from collections.abc import Iterator
from pathlib import Path

from heliograph.base.describe import KeyDescription, describe
from heliograph.link.settings import LinkSettings

PAGE = Path(__file__).parents[1] / "docs" / "settings.md"

HEAD = """# Settings

All settings of the link: what both ends agree on (`signal`), who transmits (`transmit`), scene, vehicle and camera
(`channel`), and the receiver (`receive`). The receiver is told nothing of `channel`.

A setting is changed by `--set key=value`, by a TOML file (`--settings FILE`), or in Python by `load_settings`. Items of
a list are numbered: `channel.arrays.1.x_m=3` is the second array's. `heliograph presets NAME` prints a preset with all
its values. This page is made from the code by `make settings`.
"""


def page() -> str:
    """Text of the page."""
    return HEAD + "".join(_rooms(describe(LinkSettings)))


def _rooms(keys: list[KeyDescription]) -> Iterator[str]:
    rooms: dict[str, list[KeyDescription]] = {}
    for one in keys:
        rooms.setdefault(one.key.rpartition(".")[0], []).append(one)
    for room, members in rooms.items():
        yield f"\n## {room}\n\n| key | default | values | unit | meaning |\n|---|---|---|---|---|\n"
        for one in members:
            cells = (f"`{one.key}`", _code(one.default), one.allowed, one.unit, one.meaning)
            yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"


def _code(default: str) -> str:
    return f"`{default}`" if default else "left out"


if __name__ == "__main__":
    PAGE.write_text(page())
