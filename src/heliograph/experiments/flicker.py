"""Flicker of the light of the array.

The total light of the array in slots of 250 us, as the transmitter of the preset "paper" sends random bytes. Ten
consecutive stretches of 1 s are measured, each with endless repetition. Results are medians, with the range from 5 to
95 % in brackets. Random data have a continuous spectrum, so the components depend on the bandwidth: 1 Hz here, which
neither limit prescribes. A limit is kept if 95 % of the stretches keep it, and broken if 95 % break it.

Modulation: amplitude of a Fourier component relative to the mean. IEEE 1789-2015 limits the modulation of low risk to
0.025 f % below 90 Hz and 0.08 f % up to 1250 Hz, for each component. SVM: stroboscopic visibility measure, exponent
3.7, components up to 2 kHz, threshold T(f) = 1 / (1 + exp(-0.00518 (f - 306.6))) + 20 exp(-f / 10), the closed form of
Perz et al. 2018 in CIE TN 006 and IEC TR 63158; it was not compared with the text of the standards. An SVM of 1 is just
visible, the EU allows 0.4. Flickering time period: the longest time between instants at which the light so far equals
that of a steady light of the same mean; IEEE 802.15.7 allows 5 ms. A separate header is an endless sequence of headers,
as of an array with no data.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from enum import StrEnum
from itertools import islice

import numpy as np
from matplotlib.figure import Figure

from heliograph.base.arrays import Floats
from heliograph.experiments import flicker_metrics as metrics
from heliograph.experiments import plots
from heliograph.experiments.flicker_metrics import MFTP_S, SVM_LIMIT, Flicker
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, verdict_of
from heliograph.link.settings import load_settings
from heliograph.link.simulate import transmitters
from heliograph.measure.bench import random_messages
from heliograph.signal import pwm
from heliograph.signal.settings import SignalSettings


class Signal(StrEnum):
    """Signals by name."""

    PAIRS = "M-sequence header, inverses"
    ALL_ON = "all-on header, inverses"
    BARE = "M-sequence header, no inverses"
    ALL_ON_BARE = "all-on header, no inverses"
    HEADER = "M-sequence header alone"
    ALL_ON_HEADER = "all-on header alone"
    DATA = "data alone, inverses"
    DATA_BARE = "data alone, no inverses"
    ORDERED = "M-sequence header, inverses, slot order 0, 2, 1, 3"
    SINGLE = "M-sequence header, single mode"


@dataclass(frozen=True, slots=True)
class SignalFlicker:
    """Flicker measures of each stretch of a signal."""

    stretches: list[Flicker]

    def values(self, name: str) -> Floats:
        """Measure by stretch, (stretches,)."""
        return np.array([getattr(stretch, name) for stretch in self.stretches])

    def range(self, name: str) -> tuple[float, float, float]:
        """5 % quantile, median and 95 % quantile of a measure."""
        low, middle, high = np.quantile(self.values(name), (0.05, 0.5, 0.95))
        return float(low), float(middle), float(high)

    def text(self, name: str, form: str = ".2f", scale: float = 1.0) -> str:
        """Median and range from 5 to 95 % of a measure as text."""
        low, middle, high = (format(scale * v, form) for v in self.range(name))
        return middle if low == high else f"{middle} ({low}-{high})"

    def hz(self) -> str:
        """Frequencies of the largest modulation relative to the limit, as text."""
        low, high = self.values("limit_hz").min(), self.values("limit_hz").max()
        return f"{low:g} Hz" if low == high else f"{low:g}-{high:g} Hz"

    def period(self) -> str:
        """Flickering time period in ms as text."""
        return f"{self.text('period_s', '.3g', 1e3)} ms"

    def slow(self) -> str:
        """Largest modulation below 90 Hz as text."""
        return f"{self.text('slow_percent', '.3f')} %"

    def limits(self) -> str:
        """Measures with a limit as text."""
        share, svm = self.text("limit_share"), self.text("svm")
        return f"{share} of IEEE 1789's limit at {self.hz()}, SVM {svm} (limit {SVM_LIMIT}), period {self.period()}"


def measured(flux: Floats, slot_s: float) -> SignalFlicker:
    """Measure each stretch of 1 s."""
    return SignalFlicker([metrics.measure(part, slot_s) for part in flux.reshape(-1, round(1 / slot_s))])


def wave(signal: Signal, seconds: float, seed: int = 0) -> Floats:
    """Mean light of the array in each slot of a signal with random data, (slots,) 0 to 1."""
    order = (0, 2, 1, 3) if signal is Signal.ORDERED else SignalSettings().slot_order
    # signals with no inverses or no headers need more packets
    duration = 2.2 * seconds + 0.1
    settings = load_settings(
        "paper",
        {
            "signal": {"header": "all_on" if signal.startswith("all-on") else "m_sequence", "slot_order": order},
            "transmit": {"formats": [{"mode": "single"}] if signal is Signal.SINGLE else []},
            "channel": {"duration_s": duration},
        },
    )
    sender = transmitters(settings, random_messages(settings, seed))[0]
    head, patterns = 2 * settings.signal.header_pairs, round(seconds / settings.signal.pattern_period_s)
    alone = "header alone" in signal
    packets = np.stack(list(islice(sender.packets(), 1 if alone else int(duration / settings.signal.packet_s))))
    if alone:
        packets = packets[:, :head]
    elif "alone" in signal:
        packets = packets[:, head:]
    if "no inverses" in signal:
        packets = packets[:, ::2]
    shown = packets.reshape(-1, *packets.shape[2:])
    return pwm.waveform(np.resize(shown, (patterns, *shown.shape[1:])) if alone else shown[:patterns], order)


def pair_means(flux: Floats) -> Floats:
    """Mean light of each pair of patterns, (pairs,)."""
    return np.asarray(flux.reshape(-1, 2 * pwm.SLOTS).mean(1))


def _waveforms(waves: Mapping[Signal, Floats], slot_s: float) -> Figure:
    """Light of the array over a header, shaded, and the following data."""
    shown = (Signal.PAIRS, Signal.ALL_ON, Signal.BARE, Signal.ALL_ON_BARE)
    figure = Figure(figsize=(10, 5.2))
    for axes, name in zip(figure.subplots(len(shown), 1, sharex=True), shown, strict=True):
        flux = waves[name][: 24 * pwm.SLOTS]
        axes.axvspan(0, 1e3 * slot_s * pwm.SLOTS * (2 if "no inverses" in name else 4), alpha=0.1, lw=0)
        axes.step(1e3 * slot_s * np.arange(flux.size), flux, where="post", color=plots.BLUE, lw=1)
        axes.set(ylim=(-0.05, 1.08), yticks=[0, 0.5, 1], xlim=(0, 24))
        axes.set_title(name, fontsize=9, loc="left")
    axes.set_xlabel("time (ms)")
    figure.supylabel("light, fraction of all LEDs on", fontsize=9)
    return figure


def _spectra(waves: Mapping[Signal, Floats], slot_s: float) -> Figure:
    """Modulation by frequency of a stretch, and the limit of low risk."""
    figure = Figure(figsize=(10, 4.2))
    groups = ((Signal.PAIRS, Signal.BARE), (Signal.HEADER, Signal.ALL_ON_HEADER, Signal.ALL_ON))
    for axes, names in zip(figure.subplots(1, 2, sharey=True), groups, strict=True):
        for name in names:
            lines = metrics.spectrum(waves[name][: round(1 / slot_s)], slot_s)
            modulation = 100 * np.maximum(lines.modulation, 1e-6)
            axes.plot(lines.hz, modulation, ".", ms=6 if "alone" in name else 3, label=name)
        hz = np.geomspace(1, metrics.LIMITED_HZ, 200)
        axes.plot(hz, 100 * metrics.low_risk_limit(hz), color="black", ls="--", lw=1, label="IEEE 1789, low risk")
        axes.set(xscale="log", yscale="log", ylim=(1e-4, 300), xlim=(1, 2200), xlabel="frequency (Hz)")
        axes.legend(fontsize=8, loc="upper left")
    figure.axes[0].set_ylabel("modulation (%)")
    return figure


def findings(found: Mapping[Signal, SignalFlicker], waves: Mapping[Signal, Floats], slot_s: float) -> list[Finding]:
    """Judge the claims of the paper and further questions."""
    ours, bare, header, all_on = (found[s] for s in (Signal.PAIRS, Signal.BARE, Signal.HEADER, Signal.ALL_ON_HEADER))
    single, bare_all_on = found[Signal.SINGLE], found[Signal.ALL_ON_BARE]
    slow = {"below 90 Hz": ("slow_limit_share", 1.0), "period": ("period_s", MFTP_S)}
    means = pair_means(waves[Signal.PAIRS])
    same = int((np.abs(means - means[0]) < 1e-12).sum())
    note = f"Medians of {len(ours.stretches)} stretches (5-95 %), bandwidth 1 Hz."
    broken = [limit for limit, (name, largest) in LIMITS.items() if ours.range(name)[2] > largest]
    # 1 % of margin for chance
    no_more = (single.range(n)[1] <= 1.01 * ours.range(n)[1] for n in ("slow_percent", "limit_share", "svm"))
    return [
        Finding(
            "Section IV-B: inverted signals suppress flicker.",
            f"Mean light over {2e3 * pwm.SLOTS * slot_s:g} ms: equal in {same} of {means.size} pairs. Period "
            f"{ours.period()} with inverses, {bare.period()} without; largest modulation below 90 Hz "
            f"{ours.slow()}, {ours.text('slow_limit_share')} of the limit, and "
            f"{bare.slow()}, {bare.text('slow_limit_share')} of the limit. {note}",
            verdict_of(_only_first(kept(ours, slow), kept(bare, slow))),
        ),
        Finding(
            "Section V: the flicker is eliminated by the inverted signals.",
            f"Complete signal: {ours.limits()}. {note}",
            verdict_of(kept(ours)),
            f"Not kept in all: {', '.join(broken)}. {_why(found)}" if broken else "",
        ),
        Finding(
            "Question: the header keeps the light steady too.",
            f"M-sequence header alone: {header.limits()}. All-on header alone: {all_on.limits()}. With "
            f"data, all-on: {found[Signal.ALL_ON].limits()}. {note}",
            verdict_of(_only_first(kept(header), kept(all_on))),
        ),
        Finding(
            "Question: headers without inverses.",
            f"M-sequence: period {bare.period()}; all on: period {bare_all_on.period()}, "
            f"{bare_all_on.text('slow_limit_share', '.1f')} of the limit below 90 Hz. {note}",
            "shown",
        ),
        Finding(
            "Question: data without inverses (single mode, balanced by coding) flicker as pairs do.",
            f"Single mode: {single.limits()}; largest modulation below 90 Hz {single.slow()}. Pairs: {ours.limits()}; "
            f"below 90 Hz {ours.slow()}. {note}",
            verdict_of(all(no_more)),
        ),
    ]


LIMITS = {
    "IEEE 1789's low risk": ("limit_share", 1.0),
    f"SVM {SVM_LIMIT}": ("svm", SVM_LIMIT),
    f"{1e3 * MFTP_S:g} ms of IEEE 802.15.7": ("period_s", MFTP_S),
}
"""Measure and largest value of each limit."""


def kept(flicker: SignalFlicker, limits: Mapping[str, tuple[str, float]] = LIMITS) -> bool | None:
    """True if 95 % of the stretches keep each limit, False if 95 % break a limit; else None."""
    ranges = [(flicker.range(name), largest) for name, largest in limits.values()]
    if all(high <= largest for (_, _, high), largest in ranges):
        return True
    return False if any(low > largest for (low, _, _), largest in ranges) else None


def _only_first(first: bool | None, second: bool | None) -> bool | None:
    """True if the first of two signals keeps the limits and the second breaks a limit; None if undecided."""
    if first and second is False:
        return True
    return False if first is False or second else None


def _why(found: Mapping[Signal, SignalFlicker]) -> str:
    """The part of the signal that breaks a limit."""
    data, header, ordered = found[Signal.DATA], found[Signal.HEADER], found[Signal.ORDERED]
    return (
        f"The header alone has SVM {header.text('svm')}, the data alone {data.text('svm')}: with one slot order for "
        f"all LEDs the array is brighter at the start of each T_b, {data.text('limit_share')} of the limit at "
        f"{data.hz()}. Slot order 0, 2, 1, 3 reduces it to {ordered.text('limit_share')} at {ordered.hz()}, SVM "
        f"{ordered.text('svm')}."
    )


def run(context: Context, stretches: int = 10) -> ExperimentResult:
    """Measure stretches of all signals, of 1 s each."""
    slot_s = SignalSettings().pattern_period_s / pwm.SLOTS
    waves = {signal: wave(signal, float(stretches), context.seed) for signal in Signal}
    found = {signal: measured(flux, slot_s) for signal, flux in waves.items()}
    columns: dict[str, Callable[[Signal], str]] = {
        "signal": str,
        "percent flicker": lambda signal: f"{found[signal].text('percent', '.0f')} %",
        "largest below 90 Hz, %": lambda signal: found[signal].text("slow_percent", ".3f"),
        "by its limit": lambda signal: found[signal].text("slow_limit_share"),
        "largest by limit": lambda signal: f"{found[signal].text('limit_share')} at {found[signal].hz()}",
        "SVM": lambda signal: found[signal].text("svm"),
        "period, ms": lambda signal: found[signal].text("period_s", ".3g", 1e3),
    }
    title = f"Measures of flicker: median of {stretches} stretches (5-95 %), bandwidth 1 Hz"
    spectra = "Modulation by frequency, a stretch of 1 s, bandwidth 1 Hz."
    names = [field.name for field in fields(Flicker)]
    return ExperimentResult(
        findings=findings(found, waves, slot_s),
        pictures=[
            (_waveforms(waves, slot_s), "Light of the array over a header (shaded) and the following data."),
            (_spectra(waves, slot_s), spectra),
        ],
        tables=[Table.of(title, Signal, columns)],
        data={signal: {name: flicker.values(name).tolist() for name in names} for signal, flicker in found.items()},
    )
