"""Point-spread functions as sums of Gaussians, which integrate exactly over pixels.

The panel edges have the Gaussian blur of ``camera.blur_px``.
"""

from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.channel.settings import CameraSettings


@dataclass(frozen=True)
class PointSpread:
    """Sum of Gaussians.

    Attributes
    ----------
    fraction
        (k,) share of the light, sum about 1.
    shift_px
        (k, 2) offset (x, y) in px.
    sigma_px
        (k,) standard deviation in px, above 0.

    Raises
    ------
    SettingsError
        Shapes are inconsistent, or a width is not above 0.
    """

    fraction: Floats
    shift_px: Floats
    sigma_px: Floats

    def __post_init__(self) -> None:
        """Check shapes and widths."""
        count = len(self.fraction)
        if self.shift_px.shape != (count, 2) or self.sigma_px.shape != (count,):
            shapes = f"{self.shift_px.shape} and {self.sigma_px.shape}"
            raise SettingsError(f"{count} Gaussians have (k, 2) shift_px and (k,) sigma_px, not shapes {shapes}")
        if not (self.sigma_px > 0).all():
            raise SettingsError(f"the Gaussians of a point-spread function have widths above 0, not {self.sigma_px}")


def gaussian_spread(camera: CameraSettings) -> PointSpread:
    """Return the point-spread function of the reference link: a Gaussian."""
    return PointSpread(np.ones(1), np.zeros((1, 2)), np.array([camera.blur_px]))


def halo_spread(camera: CameraSettings) -> PointSpread:
    """Return a point-spread function with veiling glare: 5 % of the light in a Gaussian of 6 times the width."""
    return PointSpread(np.array([1 - 0.05, 0.05]), np.zeros((2, 2)), camera.blur_px * np.array([1.0, 6.0]))
