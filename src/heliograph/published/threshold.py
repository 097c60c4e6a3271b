"""The receiver "threshold": zero crossing and hard decisions."""

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.build import plain_receiver
from heliograph.receive.decode.per_led import pair_luminances
from heliograph.receive.events import Observer
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame
from heliograph.receive.receiver import StreamReceiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings


def threshold_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> StreamReceiver:
    """Make the receiver "threshold": decide each bit by the zero crossing of the luminance.

    The baseline of deep decoders for LED arrays (Giap, Nguyen and Jang 2025/26: "zero-crossing"), with the threshold of
    Nagura et al. 2010, section 2: a positive luminance is +1, a negative one -1. The luminance of an LED is the
    pattern's less the inverse's at the LED's position, so that the threshold is 0 without a calibration. With
    ``signal.modulation`` "ook" the luminance itself is decided; with "haar" the data after the transform, equation
    (10), because an LED then has five levels.

    All decisions count alike in the channel decoder. The receiver "plain" reads the same luminances as soft values: the
    raw bits are equal, and "threshold" loses the gain of soft decoding. The sources have no channel decoder, or do not
    state its metric.
    """
    form = PacketFormat(signal)

    def read(frames: tuple[AnyFrame, AnyFrame], poses: tuple[Pose, Pose], gain: float) -> Floats:
        soft = form.soft_data(pair_luminances(frames, poses, gain, signal.side, "none"))
        return form.luminances(np.where(soft < 0, -1.0, 1.0))

    return plain_receiver(signal, settings, observe, read)
