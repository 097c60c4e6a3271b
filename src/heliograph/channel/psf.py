"""Point-spread functions: the image of a point of light, as a sum of Gaussians.

A sum of Gaussians is integrated over pixels as exactly as one is, so a window of a frame has the same pixels as the
whole. The panel's edges keep the Gaussian of ``camera.blur_px``.
"""

from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.channel.settings import CameraSettings

HALO_LIGHT, HALO_WIDTH = 0.05, 6.0
"""Light of the halo, and its width by the lens's own blur. Chosen, to see what veiling glare does."""


@dataclass(frozen=True)
class PointSpread:
    """A sum of Gaussians.

    Attributes
    ----------
    fraction
        (k,) light of each, in sum about 1.
    shift_px
        (k, 2) place (x, y) of each beside the point, in px.
    sigma_px
        (k,) standard deviation of each in px, above 0.

    Raises
    ------
    SettingsError
        Shapes do not fit, or a width is not above 0.
    """

    fraction: Floats
    shift_px: Floats
    sigma_px: Floats

    def __post_init__(self) -> None:
        """Check shapes and widths."""
        count = len(self.fraction)
        if self.shift_px.shape != (count, 2) or self.sigma_px.shape != (count,):
            raise SettingsError(
                f"a point-spread function of {count} Gaussians has shift_px of shape {(count, 2)} and sigma_px of "
                f"shape {(count,)}, not {self.shift_px.shape} and {self.sigma_px.shape}"
            )
        if not (self.sigma_px > 0).all():
            raise SettingsError(f"the Gaussians of a point-spread function have widths above 0, not {self.sigma_px}")


def gaussian_spread(camera: CameraSettings) -> PointSpread:
    """Point-spread function of the reference link: one Gaussian."""
    return PointSpread(np.ones(1), np.zeros((1, 2)), np.array([camera.blur_px]))


def halo_spread(camera: CameraSettings) -> PointSpread:
    """Point-spread function of a lens behind a dirty windscreen: the lens's Gaussian, and a wide and weak one."""
    fraction = np.array([1 - HALO_LIGHT, HALO_LIGHT])
    return PointSpread(fraction, np.zeros((2, 2)), camera.blur_px * np.array([1.0, HALO_WIDTH]))
