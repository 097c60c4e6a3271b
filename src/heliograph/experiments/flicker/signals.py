"""The signals whose flicker is compared: their light over time, and its measures stretch by stretch."""

from dataclasses import dataclass
from itertools import islice

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.experiments.flicker import metrics
from heliograph.experiments.flicker.metrics import Flicker
from heliograph.link.settings import load_settings
from heliograph.link.simulate import transmitters
from heliograph.measure.bench import random_messages
from heliograph.signal import pwm
from heliograph.signal.settings import SignalSettings

PAIRS, BARE = "M-sequence header, inverses", "M-sequence header, no inverses"
ALL_ON, ALL_ON_BARE = "all-on header, inverses", "all-on header, no inverses"
HEADER, ALL_ON_HEADER = "M-sequence header alone", "all-on header alone"
DATA, DATA_BARE = "data alone, inverses", "data alone, no inverses"
ORDER = (0, 2, 1, 3)
ORDERED = f"M-sequence header, inverses, slot order {', '.join(map(str, ORDER))}"

SINGLE = "M-sequence header, single mode"

SIGNALS = (PAIRS, ALL_ON, BARE, ALL_ON_BARE, HEADER, ALL_ON_HEADER, DATA, DATA_BARE, ORDERED, SINGLE)
"""All signals, by name."""

STRETCHES, STRETCH_S = 10, 1.0
"""Stretches of a signal that are measured, each by itself, and their length in s, which sets the bandwidth."""


@dataclass(frozen=True, slots=True)
class SignalFlicker:
    """Measures of all stretches of a signal."""

    # Measures of each stretch, in the order of time
    every: list[Flicker]

    def values(self, name: str) -> Floats:
        """A measure by stretch, (stretches,)."""
        return np.array([getattr(one, name) for one in self.every])

    def range(self, name: str) -> tuple[float, float, float]:
        """5 % quantile, median and 95 % quantile of a measure."""
        low, middle, high = np.quantile(self.values(name), (0.05, 0.5, 0.95))
        return float(low), float(middle), float(high)

    def text(self, name: str, form: str = ".2f", scale: float = 1.0) -> str:
        """Median and range from 5 to 95 % of a measure."""
        low, middle, high = (format(scale * v, form) for v in self.range(name))
        return middle if low == high else f"{middle} ({low}-{high})"

    def hz(self) -> str:
        """Frequencies of the largest modulation by its limit."""
        low, high = self.values("limit_hz").min(), self.values("limit_hz").max()
        return f"{low:g} Hz" if low == high else f"{low:g}-{high:g} Hz"

    def plain(self) -> dict[str, list[float]]:
        """All measures by name and stretch."""
        return {name: self.values(name).tolist() for name in self.every[0].plain()}


def measured(flux: Floats, slot_s: float) -> SignalFlicker:
    """Measures of each stretch of a signal."""
    return SignalFlicker([metrics.measure(part, slot_s) for part in flux.reshape(-1, round(STRETCH_S / slot_s))])


def wave(name: str, seconds: float, seed: int = 0) -> Floats:
    """Flux of a signal with random data. Returns (slots,) mean light of the array in each slot, 0 to 1."""
    header = "all_on" if name.startswith("all-on") else "m_sequence"
    order = ORDER if name == ORDERED else SignalSettings().slot_order
    # without inverses, and without headers, more packets are needed to fill the time
    room = 2.2 * seconds + 0.1
    formats = [{"mode": "single"}] if name == SINGLE else []
    settings = load_settings(
        "paper",
        {
            "signal": {"header": header, "slot_order": order},
            "transmit": {"formats": formats},
            "channel": {"duration_s": room},
        },
    )
    sender = transmitters(settings, random_messages(settings, seed))[0]
    head, patterns = 2 * settings.signal.header_pairs, round(seconds / settings.signal.pattern_period_s)
    alone = "header alone" in name
    packets = np.stack(list(islice(sender.packets(), 1 if alone else int(room / settings.signal.packet_s))))
    if alone:
        packets = packets[:, :head]
    elif "alone" in name:
        packets = packets[:, head:]
    if "no inverses" in name:
        packets = packets[:, ::2]
    shown = packets.reshape(-1, *packets.shape[2:])
    return pwm.waveform(np.resize(shown, (patterns, *shown.shape[1:])) if alone else shown[:patterns], order)


def pair_means(flux: Floats) -> Floats:
    """Mean light of each pair of patterns, (pairs,)."""
    return np.asarray(flux.reshape(-1, 2 * pwm.SLOTS).mean(1))
