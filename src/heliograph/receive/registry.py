"""Receivers by name."""

from collections.abc import Callable
from typing import Any, NamedTuple

from heliograph.base.registry import Registry

GROUPS = ("calibration", "detect", "track", "decode")  # groups of settings that several receivers read


class ReceiverPart(NamedTuple):
    """A receiver by name.

    Attributes
    ----------
    make
        Function of the light's signal, the receiver's settings and an observer that returns the receiver.
    settings
        Frozen dataclass of the settings in ``receive.custom``; None without settings.
    reads
        Other groups of ``receive`` that the receiver reads, of `GROUPS`.
    needs_truth
        True for a bound of this package: a fourth argument of `make` is the true channel of a simulation. No other
        receiver gets the truth.
    """

    make: Callable[..., Any]
    settings: type | None = None
    reads: tuple[str, ...] = ()
    needs_truth: bool = False


RECEIVERS: Registry[Any] = Registry(
    "receiver",
    "heliograph.receivers",
    {
        "plain": "heliograph.receive.build:plain_receiver",
        "soft": "heliograph.receive.build:soft_receiver",
        "screen": "heliograph.receive.screen.receiver:ScreenReceiver",
        "threshold": "heliograph.published.threshold:threshold_receiver",
        "kasashima": "heliograph.published.kasashima:kasashima_receiver",
        "zero-forcing": "heliograph.published.linear:zero_forcing_receiver",
        "mmse": "heliograph.published.linear:mmse_receiver",
        "genie-zero-forcing": "heliograph.published.genie:ZERO_FORCING",
        "genie-mmse": "heliograph.published.genie:MMSE",
        "svm": "heliograph.published.learned:svm_receiver",
        "mlp": "heliograph.published.learned:mlp_receiver",
        "oversampling": "heliograph.published.oversampling:OversamplingReceiver",
        "kaic": "heliograph.published.kaic:SeparationReceiver",
    },
)
"""Receivers by the setting ``receive.receiver``: a `ReceiverPart`, or a function that makes the receiver."""


def part_of(name: str) -> ReceiverPart:
    """Return the receiver of a name; raise a SettingsError if the name is unknown."""
    entry = RECEIVERS[name]
    return entry if isinstance(entry, ReceiverPart) else ReceiverPart(entry)


def is_bound(name: str) -> bool:
    """Return True for a bound, a receiver of this package that gets the true channel."""
    return name in RECEIVERS.built_in and part_of(name).needs_truth
