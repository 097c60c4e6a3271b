"""Pictures of flicker: light over time, and modulation by frequency."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.flicker import metrics
from heliograph.experiments.flicker.signals import (
    ALL_ON,
    ALL_ON_BARE,
    ALL_ON_HEADER,
    BARE,
    HEADER,
    PAIRS,
    STRETCH_S,
)
from heliograph.signal import pwm


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
