"""Link with a small camera, for fast films."""

from heliograph.link.settings import LinkSettings, load_settings

SMALL = (
    "channel.camera.width=160",
    "channel.camera.height=120",
    "channel.arrays.0.x_m=0",
    "channel.arrays.0.y_m=0",
)
"""A small camera that faces the array."""


def small(*changes: str) -> LinkSettings:
    return load_settings("static", None, [*SMALL, *changes])
