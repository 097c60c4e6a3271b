"""Flicker measures of a periodic light, from the flux by slot.

IEEE 1789-2015 low-risk limits, stroboscopic visibility measure (CIE TN 006:2016, IEC TR 63158), flickering time period
(IEEE 802.15.7).
"""

from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import ArrayLike

from heliograph.base.arrays import Floats

SVM_LIMIT = 0.4  # largest SVM that the EU ecodesign rules allow; 1 is the threshold of an average observer
MFTP_S = 5e-3  # maximum flickering time period of IEEE 802.15.7: shorter changes of the light are invisible
LIMITED_HZ = 1250.0  # frequency at which the low-risk limit of IEEE 1789 reaches 100 %


@dataclass(frozen=True, slots=True)
class Spectrum:
    """Modulation by frequency."""

    hz: Floats
    # Amplitude of each Fourier component relative to the mean
    modulation: Floats


@dataclass(frozen=True, slots=True)
class Flicker:
    """Flicker measures of a light."""

    # (max - min) / (max + min) of the flux in percent
    percent: float
    # Largest modulation below 90 Hz in percent
    slow_percent: float
    # Largest ratio of modulation to the low-risk limit of IEEE 1789, and the frequency of this component
    limit_share: float
    limit_hz: float
    # Largest ratio below 90 Hz
    slow_limit_share: float
    # Stroboscopic visibility measure; 1 is just visible
    svm: float
    # Flickering time period in s; 0 for a steady light
    period_s: float

    def plain(self) -> dict[str, float]:
        """Measures by name."""
        return asdict(self)


def measure(flux: ArrayLike, slot_s: float) -> Flicker:
    """Measure a light with endless repetition."""
    f = np.asarray(flux, float)
    lines = spectrum(f, slot_s)
    ratio = lines.modulation / low_risk_limit(lines.hz)
    worst, slow = int(np.argmax(ratio)), lines.hz < 90
    return Flicker(
        percent=percent_flicker(f),
        slow_percent=100 * float(lines.modulation[slow].max(initial=0.0)),
        limit_share=float(ratio[worst]),
        limit_hz=float(lines.hz[worst]),
        slow_limit_share=float(ratio[slow].max(initial=0.0)),
        svm=svm(lines),
        period_s=flickering_period(f, slot_s),
    )


def spectrum(flux: ArrayLike, slot_s: float) -> Spectrum:
    """Fourier components up to 2 kHz of a periodic light with constant flux in each slot, excluding the mean."""
    f = np.asarray(flux, float)
    k = np.arange(1, int(2000.0 * f.size * slot_s + 1e-9) + 1)
    hz = k / (f.size * slot_s)
    # a constant slot gives c_k = DFT_k / N sinc(f slot); the DFT continues periodically
    held = np.abs(np.fft.fft(f)[k % f.size] / f.size * np.sinc(hz * slot_s))
    return Spectrum(hz, 2 * held / max(float(f.mean()), 1e-12))


def percent_flicker(flux: ArrayLike) -> float:
    """(max - min) / (max + min) in percent: 0 for a steady light, 100 for a light that goes out."""
    f = np.asarray(flux, float)
    low, high = float(f.min()), float(f.max())
    return 100 * (high - low) / max(high + low, 1e-12)


def low_risk_limit(hz: ArrayLike) -> Floats:
    """Largest modulation of low risk by IEEE 1789-2015, 1 for 100 %; infinite above 1250 Hz."""
    f = np.asarray(hz, float)
    # 0.025 f % below 90 Hz and at most 5 %; 0.08 f % up to 1250 Hz
    limit = np.where(f < 90, np.minimum(0.025 * f, 5.0), 0.08 * f) / 100
    return np.where(f > LIMITED_HZ, np.inf, limit)


def visibility_threshold(hz: ArrayLike) -> Floats:
    """Modulation of a sine visible to half of the observers (Perz et al. 2018, CIE TN 006), 1 for 100 %."""
    f = np.asarray(hz, float)
    # T(f) = 1 / (1 + exp(-0.00518 (f - 306.6))) + 20 exp(-f / 10)
    return 1 / (1 + np.exp(-0.00518 * (f - 306.6))) + 20 * np.exp(-f / 10)


def svm(lines: Spectrum) -> float:
    """Stroboscopic visibility measure: 1 is just visible."""
    # SVM = (sum (C_m / T_m)^3.7)^(1 / 3.7)
    ratio = lines.modulation / visibility_threshold(lines.hz)
    return float((ratio**3.7).sum() ** (1 / 3.7))


def flickering_period(flux: ArrayLike, slot_s: float) -> float:
    """Longest time in s between two instants with equal mean flux so far; 0 for a steady light."""
    f = np.asarray(flux, float)
    # cumulative excess over a steady light, linear within a slot
    ahead = np.append(0.0, np.cumsum(f - f.mean()))
    small = 1e-9 * max(float(f.mean()), 1e-12) * f.size
    ahead[np.abs(ahead) < small] = 0.0
    if not ahead.any():
        return 0.0
    level = np.flatnonzero(ahead == 0)
    cross = np.flatnonzero(ahead[:-1] * ahead[1:] < 0)
    between = cross + ahead[cross] / (ahead[cross] - ahead[cross + 1])
    return float(np.diff(np.sort(np.concatenate([level, between]))).max() * slot_s)
