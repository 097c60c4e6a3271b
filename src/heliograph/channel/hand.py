"""Motion of a camera that is held in a hand: slow sway, and a tremor of the hand's own frequencies."""

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.channel.motion import Drive, Shake

SWAY_HZ = (0.1, 1.5)
"""Frequencies of the sway. Chosen: arms and breath move a phone slowly; what is slower is a user who walks."""

TREMOR_HZ = (6.0, 12.0)
"""Frequencies of the tremor: physiological tremor of a hand lies at 8 to 12 Hz, of a loaded one a little below."""

TREMOR = 0.1
"""Amplitude of the tremor by that of the sway. Chosen: at the default sway 0.5 px rms of a phone's 1000 px of focal
length, a quarter of a cell of the smallest array that is read."""

WAVES = 24
"""Sines of each band. Chosen: the sum of 24 of random phases is normal to a few per cent."""


def hand_motion(drive: Drive) -> Shake | None:
    """Return the shake of a hand: pitch, yaw and roll as sums of sines."""
    rms, rng = np.deg2rad(drive.settings.hand_deg), drive.rng
    if not rms:
        return None
    hz = np.concatenate([rng.uniform(*band, (3, WAVES)) for band in (SWAY_HZ, TREMOR_HZ)], axis=1)
    phase = rng.uniform(0, 2 * np.pi, hz.shape)
    size = rms * np.sqrt(2 / WAVES) * np.repeat([1.0, TREMOR], WAVES)

    def shake(times_s: Floats) -> Floats:
        angles = [
            (size * np.sin(2 * np.pi * f * times_s[..., None] + p)).sum(-1) for f, p in zip(hz, phase, strict=True)
        ]
        return np.stack([np.zeros_like(times_s), *angles], -1)

    return shake
