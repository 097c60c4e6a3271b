"""Data sent by an LED array, received by a high-speed camera on a moving car.

The names below are loaded when first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from heliograph.base.errors import HeliographError, MediaError, SettingsError
    from heliograph.base.frames import Frame
    from heliograph.base.registry import load_parts
    from heliograph.channel.parts import register_background, register_motion, register_point_spread
    from heliograph.datasets.dataset import write_dataset
    from heliograph.link.budget import Budget, budget
    from heliograph.link.codec import decode, encode
    from heliograph.link.photometry import LightSettings
    from heliograph.link.settings import LinkSettings, list_presets, load_settings
    from heliograph.link.simulate import simulate
    from heliograph.link.truth import TruthFile, open_truth
    from heliograph.measure.reception import Reception, receive_film
    from heliograph.media import convert_film, create_film, open_colours, open_film, open_slots
    from heliograph.media.live.camera import register_camera
    from heliograph.panel import Place, UnmixedColours, follow, locate, sample, unmix_colours
    from heliograph.receive import (
        LuminanceReceiver,
        Packet,
        Receiver,
        ReceiveSettings,
        list_receivers,
        make_receiver,
        own_settings,
        receive_frames,
        register_receiver,
    )
    from heliograph.signal.code import list_codes, register_code
    from heliograph.signal.settings import SignalSettings
    from heliograph.sweeps.plot import plot_rates
    from heliograph.sweeps.sweep import sweep
    from heliograph.transmit import Transmitter

__version__ = "1.0.0"

_HOMES = {
    "Budget": "link.budget",
    "Frame": "base.frames",
    "HeliographError": "base.errors",
    "LightSettings": "link.photometry",
    "LinkSettings": "link.settings",
    "LuminanceReceiver": "receive",
    "MediaError": "base.errors",
    "Packet": "receive",
    "Place": "panel",
    "ReceiveSettings": "receive",
    "Receiver": "receive",
    "Reception": "measure.reception",
    "SettingsError": "base.errors",
    "SignalSettings": "signal.settings",
    "Transmitter": "transmit",
    "TruthFile": "link.truth",
    "UnmixedColours": "panel",
    "budget": "link.budget",
    "convert_film": "media",
    "create_film": "media",
    "decode": "link.codec",
    "encode": "link.codec",
    "follow": "panel",
    "list_codes": "signal.code",
    "list_presets": "link.settings",
    "list_receivers": "receive",
    "load_parts": "base.registry",
    "load_settings": "link.settings",
    "locate": "panel",
    "make_receiver": "receive",
    "open_colours": "media",
    "open_film": "media",
    "open_slots": "media",
    "open_truth": "link.truth",
    "own_settings": "receive",
    "plot_rates": "sweeps.plot",
    "receive_film": "measure.reception",
    "receive_frames": "receive",
    "register_background": "channel.parts",
    "register_camera": "media.live.camera",
    "register_code": "signal.code",
    "register_motion": "channel.parts",
    "register_point_spread": "channel.parts",
    "register_receiver": "receive",
    "sample": "panel",
    "simulate": "link.simulate",
    "sweep": "sweeps.sweep",
    "unmix_colours": "panel",
    "write_dataset": "datasets.dataset",
}

__all__ = [
    "Budget",
    "Frame",
    "HeliographError",
    "LightSettings",
    "LinkSettings",
    "LuminanceReceiver",
    "MediaError",
    "Packet",
    "Place",
    "ReceiveSettings",
    "Receiver",
    "Reception",
    "SettingsError",
    "SignalSettings",
    "Transmitter",
    "TruthFile",
    "UnmixedColours",
    "budget",
    "convert_film",
    "create_film",
    "decode",
    "encode",
    "follow",
    "list_codes",
    "list_presets",
    "list_receivers",
    "load_parts",
    "load_settings",
    "locate",
    "make_receiver",
    "open_colours",
    "open_film",
    "open_slots",
    "open_truth",
    "own_settings",
    "plot_rates",
    "receive_film",
    "receive_frames",
    "register_background",
    "register_camera",
    "register_code",
    "register_motion",
    "register_point_spread",
    "register_receiver",
    "sample",
    "simulate",
    "sweep",
    "unmix_colours",
    "write_dataset",
]


def __getattr__(name: str) -> Any:
    """Load a public name from its home."""
    if name not in _HOMES:
        raise AttributeError(f"module 'heliograph' has no attribute '{name}'")
    return getattr(import_module(f"heliograph.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
