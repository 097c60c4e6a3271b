"""Make docs/settings.md from the settings classes: `python scripts/make_settings.py`, or `make settings`."""

from collections.abc import Iterable, Iterator
from pathlib import Path

from heliograph.cli.presets import KeyDescription, describe
from heliograph.link.settings import LinkSettings

PAGE = Path(__file__).parents[1] / "docs" / "settings.md"

HEAD = """# Settings

All settings of the link: signal of both ends (`signal`), transmitter (`transmit`), scene, vehicle and camera
(`channel`), and receiver (`receive`). The receiver has no access to `channel`.

Change a setting with `--set key=value`, a TOML file (`--settings FILE`), or `load_settings` in Python. Numbers
select items of a list: `channel.arrays.1.x_m=3` changes the second array. `heliograph presets NAME` prints all values
of a preset. `make settings` generates this page.
"""


def page() -> str:
    """Text of the page."""
    return HEAD + "".join(_tables(describe(LinkSettings)))


def _tables(keys: Iterable[KeyDescription]) -> Iterator[str]:
    tables: dict[str, list[KeyDescription]] = {}
    for about in keys:
        tables.setdefault(about.key.rpartition(".")[0], []).append(about)
    for table, members in tables.items():
        yield f"\n## {table}\n\n| key | default | values | unit | meaning |\n|---|---|---|---|---|\n"
        for about in members:
            cells = (f"`{about.key}`", _code(about.default), about.allowed, about.unit, about.meaning)
            yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |\n"


def _code(default: str) -> str:
    return f"`{default}`" if default else "left out"


if __name__ == "__main__":
    PAGE.write_text(page())
