"""Flicker of the array: headers and data, with and without inverted patterns, by IEEE 1789 and CIE TN 006."""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice

import numpy as np
from matplotlib.figure import Figure

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.flicker import metrics
from heliograph.experiments.flicker.metrics import MFTP_S, SVM_LIMIT, Flicker
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, Verdict
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


def waveforms(waves: Mapping[str, Floats], slot_s: float) -> Figure:
    """Light of the whole array over a header, shaded, and the data after it."""
    shown = (PAIRS, ALL_ON, BARE, ALL_ON_BARE)
    figure = Figure(figsize=(12, 5.2))
    for axes, name in zip(figure.subplots(len(shown), 1, sharex=True), shown, strict=True):
        flux = waves[name][: 24 * pwm.SLOTS]
        header = 1e3 * slot_s * pwm.SLOTS * (4 if name in (PAIRS, ALL_ON) else 2)
        axes.axvspan(0, header, color=plots.BLUE, alpha=0.1, lw=0)
        axes.step(1e3 * slot_s * np.arange(flux.size), flux, where="post", color=plots.BLUE, lw=1)
        axes.set(ylim=(-0.05, 1.08), yticks=[0, 0.5, 1], xlim=(0, 24))
        axes.set_title(name, fontsize=9, loc="left")
        plots.tidy(axes)
    axes.set_xlabel("time (ms)")
    figure.supylabel("light, fraction of all LEDs on", fontsize=9)
    figure.tight_layout()
    return figure


def spectra(waves: Mapping[str, Floats], slot_s: float) -> Figure:
    """Modulation by frequency of one stretch, and the limit of low risk."""
    figure = Figure(figsize=(12, 4.2))
    groups = ((PAIRS, BARE), (HEADER, ALL_ON_HEADER, ALL_ON))
    for axes, names in zip(figure.subplots(1, 2, sharey=True), groups, strict=True):
        for name, colour in zip(names, (plots.BLUE, plots.ORANGE, plots.PINK), strict=False):
            lines = metrics.spectrum(waves[name][: round(STRETCH_S / slot_s)], slot_s)
            axes.plot(
                lines.hz,
                100 * np.maximum(lines.modulation, 1e-6),
                ".",
                ms=6 if "alone" in name else 3,
                color=colour,
                label=name,
            )
        hz = np.geomspace(1, metrics.LIMITED_HZ, 200)
        axes.plot(hz, 100 * metrics.low_risk_limit(hz), color=plots.BLACK, ls="--", lw=1)
        axes.set(xscale="log", yscale="log", ylim=(1e-4, 300), xlim=(1, 2200), xlabel="frequency (Hz)")
        axes.legend(frameon=False, fontsize=8, loc="upper left")
        plots.tidy(axes)
    figure.axes[0].set_ylabel("modulation (%)")
    figure.tight_layout()
    return figure


def findings(found: Mapping[str, SignalFlicker], waves: Mapping[str, Floats], slot_s: float) -> list[Finding]:
    """The paper's claims, and questions of our own."""
    ours, bare, header, all_on = (found[name] for name in (PAIRS, BARE, HEADER, ALL_ON_HEADER))
    means = pair_means(waves[PAIRS])
    same = int((np.abs(means - means[0]) < 1e-12).sum())
    return [
        Finding(
            "Section IV-B: inverted signals suppress flicker.",
            f"Mean light over {2e3 * pwm.SLOTS * slot_s:g} ms: equal in {same} of {means.size} pairs. Period "
            f"{ms_text(ours)} with inverses, {ms_text(bare)} without; largest modulation below 90 Hz "
            f"{ours.text('slow_percent', '.3f')} %, {ours.text('slow_limit_share')} of the limit, and "
            f"{bare.text('slow_percent', '.3f')} %, {bare.text('slow_limit_share')} of it. {_STATED}",
            _verdict(kept(ours, SLOW), _opposite(kept(bare, SLOW))),
        ),
        Finding(
            "Section V: the flicker is eliminated by the inverted signals.",
            f"Whole signal: {_all(ours)}. {_STATED}",
            _verdict(kept(ours)),
            "" if kept(ours) else f"Not kept in all: {', '.join(_broken(ours))}. {_why(found)}",
        ),
        Finding(
            "Asked: the header keeps the light steady too.",
            f"M-sequence header alone: {_all(header)}. All-on header alone: {_all(all_on)}. With "
            f"data, all-on: {_all(found[ALL_ON])}. {_STATED}",
            _verdict(kept(header), _opposite(kept(all_on))),
        ),
        Finding(
            "Asked: headers without inverses.",
            f"M-sequence: period {ms_text(bare)}; all on: period {ms_text(found[ALL_ON_BARE])}, "
            f"{found[ALL_ON_BARE].text('slow_limit_share', '.1f')} of the limit below 90 Hz. {_STATED}",
            "shown",
        ),
        Finding(
            "Asked: data without inverses (single mode, balanced by coding) flicker as pairs do.",
            f"Single mode: {_all(found[SINGLE])}; largest modulation below 90 Hz "
            f"{found[SINGLE].text('slow_percent', '.3f')} %. Pairs: {_all(ours)}; below 90 Hz "
            f"{ours.text('slow_percent', '.3f')} %. {_STATED}",
            _verdict(*(_no_more(found[SINGLE], ours, name) for name in ("slow_percent", "limit_share", "svm"))),
        ),
    ]


_STATED = f"Medians of {STRETCHES} stretches (5-95 %), bandwidth {1 / STRETCH_S:g} Hz."

LIMITS = {
    "IEEE 1789's low risk": ("limit_share", 1.0),
    f"SVM {SVM_LIMIT}": ("svm", SVM_LIMIT),
    f"{1e3 * MFTP_S:g} ms of IEEE 802.15.7": ("period_s", MFTP_S),
}
SLOW = {"below 90 Hz": ("slow_limit_share", 1.0), "period": ("period_s", MFTP_S)}
"""Limits of slow changes: measures and their largest values."""


def kept(one: SignalFlicker, limits: Mapping[str, tuple[str, float]] = LIMITS) -> bool | None:
    """Whether all limits are kept (by 95 % of the stretches) or one is broken (by 95 %); None: neither."""
    ranges = [(one.range(name), largest) for name, largest in limits.values()]
    if all(high <= largest for (_, _, high), largest in ranges):
        return True
    return False if any(low > largest for (low, _, _), largest in ranges) else None


def _no_more(one: SignalFlicker, other: SignalFlicker, name: str) -> bool:
    """Whether the median of a measure is at most the other's, a hundredth left for chance."""
    return one.range(name)[1] <= 1.01 * other.range(name)[1]


def _opposite(kept: bool | None) -> bool | None:
    return None if kept is None else not kept


def _verdict(*parts: bool | None) -> Verdict:
    """Whether all parts are true; "shown" where one is None and none is false."""
    if all(parts):
        return "holds"
    return "differs" if False in parts else "shown"


def _broken(one: SignalFlicker) -> list[str]:
    """Limits that are not kept in 95 % of the stretches."""
    return [what for what, (name, largest) in LIMITS.items() if one.range(name)[2] > largest]


def _why(found: Mapping[str, SignalFlicker]) -> str:
    """The part of the signal that breaks a limit."""
    data, header = found[DATA], found[HEADER]
    return (
        f"The header alone has SVM {header.text('svm')}, the data alone {data.text('svm')}: with one slot order for "
        f"all LEDs the array is brighter at the start of each T_b, {data.text('limit_share')} of the limit at "
        f"{data.hz()}. Slot order {', '.join(map(str, ORDER))} makes it {found[ORDERED].text('limit_share')} at "
        f"{found[ORDERED].hz()}, SVM {found[ORDERED].text('svm')}."
    )


def _all(one: SignalFlicker) -> str:
    return (
        f"{one.text('limit_share')} of IEEE 1789's limit at {one.hz()}, SVM {one.text('svm')} (limit {SVM_LIMIT}), "
        f"period {ms_text(one)}"
    )


def ms_text(one: SignalFlicker) -> str:
    """Flickering time period as text: median and range in ms."""
    return f"{one.text('period_s', '.3g', 1e3)} ms"


HEAD = (
    "signal", "percent flicker", "largest below 90 Hz, %", "by its limit", "largest by limit", "SVM", "period, ms"
)  # fmt: skip

TEXT = (
    f"The light of the whole array in slots of 250 us, as the transmitter of the preset sends it, of random bytes. "
    f"Measured in {STRETCHES} stretches of {STRETCH_S:g} s that follow each other, each taken as repeated without end; "
    "stated is their median and, in brackets, the range from 5 to 95 %. Random data have no lines but a continuous "
    f"spectrum, whose components depend on the bandwidth: it is {1 / STRETCH_S:g} Hz here, which neither limit "
    "prescribes. A limit counts as kept where 95 % of the stretches keep it, as broken where 95 % break it. "
    "Modulation: amplitude of a Fourier component by the mean; the limits are IEEE 1789-2015's of low risk, "
    "0.025 f % below 90 Hz and 0.08 f % up to 1250 Hz, component by component. "
    "SVM: stroboscopic visibility measure, exponent 3.7, components up to 2 kHz, threshold T(f) = 1 / (1 + "
    "exp(-0.00518 (f - 306.6))) + 20 exp(-f / 10), the closed form of Perz et al. 2018 that CIE TN 006 and IEC TR "
    "63158 use, not compared with the standards' text; 1 is just visible, the EU allows 0.4. "
    "Flickering time period: the longest time between instants at which the light given so far equals that of a "
    "steady light of the same mean; IEEE 802.15.7 allows 5 ms. A header alone is that header repeated, as an array "
    "would show that only wants to be found."
)


def run(context: Context) -> ExperimentResult:
    """Measure all signals."""
    slot_s = SignalSettings().pattern_period_s / pwm.SLOTS
    waves = {name: wave(name, STRETCHES * STRETCH_S, context.seed) for name in SIGNALS}
    found = {name: measured(flux, slot_s) for name, flux in waves.items()}
    return ExperimentResult(
        key="flicker",
        title="Flicker of the whole array",
        text=TEXT,
        findings=findings(found, waves, slot_s),
        pictures=[
            (waveforms(waves, slot_s), "Light of the whole array over a header (shaded) and the data after it."),
            (
                spectra(waves, slot_s),
                f"Modulation by frequency, one stretch of {STRETCH_S:g} s, bandwidth {1 / STRETCH_S:g} Hz; dashed: "
                "IEEE 1789's limit of low risk.",
            ),
        ],
        tables=[
            Table(
                f"Measures of flicker: median of {STRETCHES} stretches (5-95 %), bandwidth {1 / STRETCH_S:g} Hz",
                HEAD,
                [_row(name, one) for name, one in found.items()],
            )
        ],
        data={name: one.plain() for name, one in found.items()},
    )


def _row(name: str, one: SignalFlicker) -> list[str]:
    return [
        name,
        f"{one.text('percent', '.0f')} %",
        one.text("slow_percent", ".3f"),
        one.text("slow_limit_share"),
        f"{one.text('limit_share')} at {one.hz()}",
        one.text("svm"),
        one.text("period_s", ".3g", 1e3),
    ]
