"""Data sent by an LED array, received by a high-speed camera on a moving car.

The names below are loaded when first used, so that importing the package costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from heliograph.base.errors import HeliographError, MediaError, SettingsError
    from heliograph.base.frames import Frame
    from heliograph.base.registry import load_parts
    from heliograph.benchmarks.benchmark import benchmark
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
    from heliograph.receive.api import list_receivers, make_receiver, own_settings, receive_frames, register_receiver
    from heliograph.receive.luminance_receiver import LuminanceReceiver
    from heliograph.receive.packet import Packet, Receiver
    from heliograph.receive.settings import ReceiveSettings
    from heliograph.signal.code import list_codes, register_code
    from heliograph.signal.settings import SignalSettings
    from heliograph.sweeps.plot import plot_rates
    from heliograph.sweeps.sweep import sweep
    from heliograph.transmit import Transmitter

__version__ = "1.0.0"

_NAMES = {
    "base.errors": "HeliographError MediaError SettingsError",
    "base.frames": "Frame",
    "base.registry": "load_parts",
    "benchmarks.benchmark": "benchmark",
    "channel.parts": "register_background register_motion register_point_spread",
    "datasets.dataset": "write_dataset",
    "link.budget": "Budget budget",
    "link.codec": "decode encode",
    "link.photometry": "LightSettings",
    "link.settings": "LinkSettings list_presets load_settings",
    "link.simulate": "simulate",
    "link.truth": "TruthFile open_truth",
    "measure.reception": "Reception receive_film",
    "media": "convert_film create_film open_colours open_film open_slots",
    "media.live.camera": "register_camera",
    "panel": "Place UnmixedColours follow locate sample unmix_colours",
    "receive.api": "list_receivers make_receiver own_settings receive_frames register_receiver",
    "receive.luminance_receiver": "LuminanceReceiver",
    "receive.packet": "Packet Receiver",
    "receive.settings": "ReceiveSettings",
    "signal.code": "list_codes register_code",
    "signal.settings": "SignalSettings",
    "sweeps.plot": "plot_rates",
    "sweeps.sweep": "sweep",
    "transmit": "Transmitter",
}
"""Public names by home."""

_HOMES = {name: home for home, names in _NAMES.items() for name in names.split()}

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
    "benchmark",
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
