"""Flicker of the whole array: headers and data, with and without inverted patterns."""

from itertools import islice
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from heliograph.experiments import flicker
from heliograph.experiments.chapter import Chapter, Context, Finding, Table
from heliograph.experiments.flicker import MFTP_S, SVM_LIMIT, Flicker, Spectrum
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, transmitters
from heliograph.signal import pwm
from heliograph.signal.settings import SignalSettings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

PAIRS, BARE = "M-sequence header, inverses", "M-sequence header, no inverses"
ALL_ON, ALL_ON_BARE = "all-on header, inverses", "all-on header, no inverses"
HEADER, ALL_ON_HEADER = "M-sequence header alone", "all-on header alone"
DATA, DATA_BARE = "data alone, inverses", "data alone, no inverses"
ORDER = (0, 2, 1, 3)
ORDERED = f"M-sequence header, inverses, slot order {', '.join(map(str, ORDER))}"

SIGNALS = (PAIRS, ALL_ON, BARE, ALL_ON_BARE, HEADER, ALL_ON_HEADER, DATA, DATA_BARE, ORDERED)

TEXT = (
    "The light of the whole array in slots of 250 us, as the transmitter of the preset sends it, repeated without "
    "end. Modulation: amplitude of a Fourier component by the mean; the limits are IEEE 1789-2015's of low risk, "
    "0.025 f % below 90 Hz and 0.08 f % up to 1250 Hz, line by line (random data has lines as close as the stretch is "
    "long). SVM: stroboscopic visibility measure, exponent 3.7, components up to 2 kHz, threshold T(f) = 1 / (1 + "
    "exp(-0.00518 (f - 306.6))) + 20 exp(-f / 10), the closed form of Perz et al. 2018 that CIE TN 006 and IEC TR "
    "63158 use, quoted from memory and not compared with the standards' text; 1 is just visible, the EU allows 0.4. "
    "Flickering time period: the longest time between instants at which the light given so far equals that of a "
    "steady light of the same mean; IEEE 802.15.7 allows 5 ms. A header alone is that header repeated, as an array "
    "would show that only wants to be found."
)


def run(context: Context) -> Chapter:
    """Measure all signals."""
    slot_s = SignalSettings().pattern_period_s / pwm.SLOTS
    waves = {name: wave(name, 1.0 if context.quick else 10.0) for name in SIGNALS}
    found = {name: flicker.measure(flux, slot_s) for name, flux in waves.items()}
    return Chapter(
        key="flicker",
        title="Flicker of the whole array",
        text=TEXT,
        findings=findings(found, waves, slot_s),
        pictures=[
            (_waveforms(waves, slot_s), "Light of the whole array over a header (shaded) and the data after it."),
            (_spectra(waves, slot_s), "Modulation by frequency; dashed: IEEE 1789's limit of low risk."),
        ],
        tables=[
            Table(
                "Measures of flicker",
                [
                    "signal",
                    "percent flicker",
                    "largest below 90 Hz",
                    "by its limit",
                    "largest by limit",
                    "SVM",
                    "period",
                ],
                [_row(name, one) for name, one in found.items()],
            )
        ],
        data={name: one.plain() for name, one in found.items()},
    )


def wave(name: str, seconds: float) -> Floats:
    """Flux of a signal by slot, over whole packets."""
    header = "all_on" if name.startswith("all-on") else "m_sequence"
    order = ORDER if name == ORDERED else SignalSettings().slot_order
    settings = load_settings("paper", {"signal": {"header": header, "slot_order": order}})
    sender = transmitters(settings, default_messages(settings))[0]
    count = max(1, round(seconds / settings.signal.packet_s))
    packets = np.stack(list(islice(sender.packets(), count)))
    head = 2 * settings.signal.header_pairs
    if "alone" in name:
        packets = packets[:, :head] if "header" in name else packets[:, head:]
    if "no inverses" in name:
        packets = packets[:, ::2]
    return pwm.waveform(packets.reshape(-1, *packets.shape[2:]), order)


def pair_means(flux: Floats) -> Floats:
    """Mean light of each pair of patterns."""
    return np.asarray(flux.reshape(-1, 2 * pwm.SLOTS).mean(1))


def findings(found: dict[str, Flicker], waves: dict[str, Floats], slot_s: float) -> list[Finding]:
    """The paper's claims, and what was asked."""
    ours, bare = found[PAIRS], found[BARE]
    means = pair_means(waves[PAIRS])
    same = int((np.abs(means - means[0]) < 1e-12).sum())
    return [
        Finding(
            "Section IV-B: inverted signals suppress flicker.",
            f"Mean light over {2e3 * pwm.SLOTS * slot_s:g} ms: equal in {same} of {means.size} pairs. Period "
            f"{_ms(ours)} with inverses, {_ms(bare)} without; largest modulation below 90 Hz {ours.slow_percent:.3f} % "
            f"({ours.slow_limit_share:.2f} of the limit) and {bare.slow_percent:.3f} % ({bare.slow_limit_share:.2f}).",
            "holds" if _slow_good(ours) and not _slow_good(bare) else "differs",
        ),
        Finding(
            "Section V: the flicker is eliminated by the inverted signals.",
            f"Whole signal: {_all(ours)}.",
            "holds" if _good(ours) else "differs",
            "" if _good(ours) else f"Not kept: {', '.join(_broken(ours))}. {_why(found)}",
        ),
        Finding(
            "Asked: the header keeps the light steady too.",
            f"M-sequence header alone: {_all(found[HEADER])}. All-on header alone: {_all(found[ALL_ON_HEADER])}. With "
            f"data, all-on: {_all(found[ALL_ON])}.",
            "holds" if _good(found[HEADER]) and not _good(found[ALL_ON_HEADER]) else "differs",
        ),
        Finding(
            "Asked: headers without inverses.",
            f"M-sequence: period {_ms(bare)}; all on: period {_ms(found[ALL_ON_BARE])}, "
            f"{found[ALL_ON_BARE].slow_limit_share:.1f} of the limit below 90 Hz.",
            "shown",
        ),
    ]


def _slow_good(one: Flicker) -> bool:
    return one.period_s <= MFTP_S and one.slow_limit_share <= 1


def _broken(one: Flicker) -> list[str]:
    """Limits that are not kept."""
    limits = (
        ("IEEE 1789's low risk", one.limit_share <= 1),
        (f"SVM {SVM_LIMIT}", one.svm <= SVM_LIMIT),
        (f"{1e3 * MFTP_S:g} ms of IEEE 802.15.7", one.period_s <= MFTP_S),
    )
    return [name for name, kept in limits if not kept]


def _good(one: Flicker) -> bool:
    return not _broken(one)


def _why(found: dict[str, Flicker]) -> str:
    """Which part of the signal it is."""
    data, header = found[DATA], found[HEADER]
    return (
        f"The header alone has SVM {header.svm:.2f}, the data alone {data.svm:.2f}: with one slot order for all LEDs "
        f"the array is brighter at the start of each T_b, {data.limit_share:.2f} of the limit at {data.limit_hz:g} Hz. "
        f"Slot order {', '.join(map(str, ORDER))} makes it {found[ORDERED].limit_share:.2f}, SVM "
        f"{found[ORDERED].svm:.2f}."
    )


def _all(one: Flicker) -> str:
    return (
        f"{one.limit_share:.2f} of IEEE 1789's limit at {one.limit_hz:g} Hz, SVM {one.svm:.2f} (limit {SVM_LIMIT}), "
        f"period {_ms(one)}"
    )


def _ms(one: Flicker) -> str:
    return f"{1e3 * one.period_s:.3g} ms"


def _row(name: str, one: Flicker) -> list[str]:
    return [
        name,
        f"{one.percent:.0f} %",
        f"{one.slow_percent:.3f} %",
        f"{one.slow_limit_share:.2f}",
        f"{one.limit_share:.2f} at {one.limit_hz:g} Hz",
        f"{one.svm:.2f}",
        _ms(one),
    ]


def _waveforms(waves: dict[str, Floats], slot_s: float) -> "Figure":
    from matplotlib.figure import Figure

    shown = (PAIRS, ALL_ON, BARE, ALL_ON_BARE)
    figure = Figure(figsize=(12, 5.2))
    for axes, name in zip(figure.subplots(len(shown), 1, sharex=True), shown, strict=True):
        flux = waves[name][: 24 * pwm.SLOTS]
        header = 1e3 * slot_s * pwm.SLOTS * (4 if name in (PAIRS, ALL_ON) else 2)
        axes.axvspan(0, header, color="#1b6ca8", alpha=0.1, lw=0)
        axes.step(1e3 * slot_s * np.arange(flux.size), flux, where="post", color="#1b6ca8", lw=1)
        axes.set(ylim=(-0.05, 1.08), yticks=[0, 0.5, 1], xlim=(0, 24))
        axes.set_title(name, fontsize=9, loc="left")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, lw=0.6)
    axes.set_xlabel("time (ms)")
    figure.supylabel("light, share of all LEDs on", fontsize=9)
    figure.tight_layout()
    return figure


def _spectra(waves: dict[str, Floats], slot_s: float) -> "Figure":
    from matplotlib.figure import Figure

    figure = Figure(figsize=(12, 4.2))
    groups = ((PAIRS, BARE), (HEADER, ALL_ON_HEADER, ALL_ON))
    for axes, names in zip(figure.subplots(1, 2, sharey=True), groups, strict=True):
        for name, colour in zip(names, ("#1b6ca8", "#d1741f", "#b5446e"), strict=False):
            lines: Spectrum = flicker.spectrum(waves[name], slot_s)
            axes.plot(
                lines.hz,
                100 * np.maximum(lines.modulation, 1e-6),
                ".",
                ms=6 if "alone" in name else 3,
                color=colour,
                label=name,
            )
        hz = np.geomspace(1, flicker.LIMITED_HZ, 200)
        axes.plot(hz, 100 * flicker.low_risk_limit(hz), color="#1d2126", ls="--", lw=1)
        axes.set(xscale="log", yscale="log", ylim=(1e-4, 300), xlim=(1, 2200), xlabel="frequency (Hz)")
        axes.legend(frameon=False, fontsize=8, loc="upper left")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, lw=0.6)
    figure.axes[0].set_ylabel("modulation (%)")
    figure.tight_layout()
    return figure
