"""Data sent by an LED array, received by a high-speed camera on a moving car.

The names below are loaded when first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from heliograph.base.errors import HeliographError, MediaError, SettingsError
    from heliograph.base.frames import Frame
    from heliograph.link.codec import decode, encode
    from heliograph.link.settings import LinkSettings, load_settings
    from heliograph.link.simulate import simulate
    from heliograph.media import create_film, open_film
    from heliograph.receive import Packet, Receiver, receive_frames
    from heliograph.signal.settings import SignalSettings
    from heliograph.sweeps.sweep import sweep
    from heliograph.transmit import Transmitter

__version__ = "0.1.0"

_HOMES = {
    "Frame": "base.frames",
    "HeliographError": "base.errors",
    "LinkSettings": "link.settings",
    "MediaError": "base.errors",
    "Packet": "receive",
    "Receiver": "receive",
    "SettingsError": "base.errors",
    "SignalSettings": "signal.settings",
    "Transmitter": "transmit",
    "create_film": "media",
    "decode": "link.codec",
    "encode": "link.codec",
    "load_settings": "link.settings",
    "open_film": "media",
    "receive_frames": "receive",
    "simulate": "link.simulate",
    "sweep": "sweeps.sweep",
}

__all__ = [
    "Frame",
    "HeliographError",
    "LinkSettings",
    "MediaError",
    "Packet",
    "Receiver",
    "SettingsError",
    "SignalSettings",
    "Transmitter",
    "create_film",
    "decode",
    "encode",
    "load_settings",
    "open_film",
    "receive_frames",
    "simulate",
    "sweep",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its home."""
    if name not in _HOMES:
        raise AttributeError(f"module 'heliograph' has no attribute '{name}'")
    return getattr(import_module(f"heliograph.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
