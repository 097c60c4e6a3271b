"""The receivers "zero-forcing" and "mmse": linear equalisers of all pixels, with the estimated channel."""

from functools import partial

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.build import plain_receiver
from heliograph.receive.decode.per_led import unblurred
from heliograph.receive.events import Observer
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame
from heliograph.receive.observe.cutout import measure_noise, take_cutout
from heliograph.receive.receiver import StreamReceiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal.settings import SignalSettings

LOADING = 1e-10  # loading of least squares in place of a pseudo-inverse: far below any noise


def zero_forcing_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> StreamReceiver:
    """Make the receiver "zero-forcing": least squares with the blur matrix.

    The camera channel of visual MIMO (Ashok et al. 2010) is r = A x + n, with the light of LED k on each pixel in
    column k of A. The zero-forcing equaliser

        x = (A^T A)^-1 A^T r

    removes the interference of all LEDs and amplifies the noise where LEDs are closer than pixels. A follows from the
    estimated pose and blur; publications assume that A is known, as for "genie-zero-forcing".
    """
    return plain_receiver(signal, settings, observe, partial(unblurred, side=signal.side, loading=LOADING))


def mmse_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> StreamReceiver:
    """Make the receiver "mmse": linear minimum mean square error with the blur matrix.

    As the receiver "zero-forcing", but

        x = (A^T A + s^2 / (g^2 v) I)^-1 A^T r

    with the noise variance s^2 of a pixel, measured on the sum of each pair, the gain g, and the variance v of the
    light of an LED in units of half the step from off to on: 1 for "ook", 1/4 for "haar".
    """
    variance = 0.25 if signal.modulation == "haar" else 1.0

    def read(frames: tuple[AnyFrame, AnyFrame], poses: tuple[Pose, Pose], gain: float) -> Floats:
        cutout = take_cutout(FramePair(*frames), poses, signal.side)
        noise = measure_noise([cutout], gain, signal.side).lit
        return unblurred(frames, poses, gain, signal.side, noise / max(variance * gain**2, TINY))

    return plain_receiver(signal, settings, observe, read)
