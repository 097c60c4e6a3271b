"""Flicker of the whole array: headers and data, with and without inverted patterns."""

from heliograph.experiments.flicker.pictures import spectra, waveforms
from heliograph.experiments.flicker.signals import SIGNALS, STRETCH_S, STRETCHES, SignalFlicker, measured, wave
from heliograph.experiments.flicker.verdicts import findings
from heliograph.experiments.result import Context, ExperimentResult, Table
from heliograph.signal import pwm
from heliograph.signal.settings import SignalSettings

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
