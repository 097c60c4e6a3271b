"""A link with a small camera, so that films of it are soon made."""

from heliograph.link.settings import LinkSettings, load_settings

SMALL = (
    "channel.camera.width=160",
    "channel.camera.height=120",
    "channel.arrays.0.x_m=0",
    "channel.arrays.0.y_m=0",
)
"""A small camera that looks straight at the array."""


def small(*changes: str) -> LinkSettings:
    return load_settings("static", None, [*SMALL, *changes])
