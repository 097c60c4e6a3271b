"""Compare a receiver of one's own with the receivers of the package.

Run `python examples/own_receiver.py`. The script counts codeword errors over distance and plots the rates in
own_receiver.png, in about a minute. It requires the extra `analysis`. The file also extends the command line:
`heliograph --load examples/own_receiver.py receive film.mkv --receiver wiener`.
"""

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import map_coordinates

import heliograph


@dataclass(frozen=True)
class WienerSettings:
    """Settings for `--set receive.custom.noise=0.1`, or `--vary receive.custom.noise=0.03,0.1,0.3` in a sweep."""

    noise: float = 0.1
    """Ratio of the noise power to the power of the light."""


class Wiener(heliograph.LuminanceReceiver):
    """Sharpens the difference of a pattern and its inverse by a Wiener filter, and samples it at the LEDs."""

    def luminances(self, pattern: Any, inverse: Any, leds: Any) -> Any:
        """Return the luminance of each LED; see `heliograph.LuminanceReceiver`."""
        own, blur_px = heliograph.own_settings(self.settings), self.settings.calibration.blur_px
        down, across = (np.fft.fftfreq(count) for count in pattern.shape)
        blur = np.exp(-2 * (np.pi * blur_px) ** 2 * (down[:, None] ** 2 + across**2))
        sharp = np.fft.ifft2(np.fft.fft2(pattern - inverse) * blur / (blur**2 + own.noise)).real
        x, y = np.moveaxis(leds.mean(axis=0), -1, 0)
        return map_coordinates(sharp, (y, x), order=3, mode="nearest")


heliograph.register_receiver("wiener", Wiener, WienerSettings, reads=["calibration", "detect", "track", "decode"])


def main(few: bool) -> None:
    """Compare the three receivers."""
    data = heliograph.sweep(
        {"receiver": ["wiener", "plain", "soft"], "channel.distance_m": [60] if few else [50, 60, 70, 80, 90]},
        set={"signal.data_pairs": 16 if few else 48},
        min_errors=5 if few else 10,
        max_codewords=2 if few else 12,
    )
    figure = Figure(figsize=(13, 4), layout="constrained")
    for axes, layer in zip(figure.subplots(1, 3, sharey=True), data.layer.values, strict=True):
        rates = data.sel(layer=layer)
        heliograph.plot_rates(rates, "fer", along="channel.distance_m", axes=axes)
        axes.set_title(f"{layer} layer")
        print(layer, rates.codeword_errors.values.tolist(), "of", rates.codewords.values.tolist())
    figure.savefig("own_receiver.png", dpi=120)


if __name__ == "__main__":
    main("--few" in sys.argv)
