"""The soft receiver with the channel known: the true pose, blur, gain and noise in place of estimates.

Only experiments give a receiver the truth; everything else about it is the receiver's own.
"""

import numpy as np

from heliograph.base.threads import one_thread
from heliograph.channel import ArrayTruth
from heliograph.experiments.links import true_pose
from heliograph.link.settings import LinkSettings
from heliograph.receive import Receiver
from heliograph.receive.build import soft_receiver
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.soft_packet import SoftPacket
from heliograph.receive.decode.turbo_equaliser import decode_iteratively
from heliograph.receive.decode.worker import Decoded
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.events import ExtractEvent, Observer, ignore
from heliograph.receive.observe.cutout import take_cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.track import TrackedPair

Truths = dict[int, ArrayTruth]
"""The array's truth by number of the frame."""


class KnownPacket(SoftPacket):
    """The soft receiver's observations with the true channel in place of the estimated one.

    Parameters
    ----------
    link
        The link as simulated, with one array at rest in step.
    truths
        Truth of each frame taken so far.
    """

    def __init__(self, link: LinkSettings, truths: Truths):
        self._link, self._truths, self._true_gain = link, truths, 0.0
        self._decoding = Decoding("log-map", link.receive.decode.iterations)
        super().__init__(link.transmit.identities[0], link.signal, self._decoding)

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> ExtractEvent:  # noqa: ARG002 - the truth is known
        """Add a pair with its true poses; see `PacketObservations`.

        Parameters
        ----------
        place
            Number of the pair in its packet's data, from 0.
        pair
            Camera frames of the pair; their numbers name the truths.
        tracked
            The array in them, as it was followed; ignored, for the truth is known.
        """
        first, second = (self._truths[frame.index] for frame in (pair.pattern, pair.inverted))
        poses = true_pose(first, self._link), true_pose(second, self._link)
        self._cutouts[place] = take_cutout(pair, poses, self._link.signal.side)
        self._true_gain = true_gain(first, self._link)
        return ExtractEvent(self._identity, (pair.pattern, pair.inverted), poses)

    def has_codeword(self) -> bool:
        """Return False: no check is faster than decoding; see `PacketObservations`."""
        return False

    @one_thread()
    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, observe: Observer, /) -> Decoded:  # noqa: ARG002 - the protocol's
        """Codewords by layer.

        Parameters
        ----------
        led_gains, buffer
            State of the array; ignored.
        observe
            Gets nothing: no event tells of this decoding.
        """
        gain, sound = self._true_gain, LedGains.sound(self._link.signal.side)
        observed = _FixedPoses(self.cutouts, true_noise(gain, self._link), self.form, sound)
        return Decoded(decode_iteratively(observed, gain, self._identity, self._decoding).words)


class _FixedPoses(ObservedPacket):
    """Pairs whose poses and LED gains are right already."""

    def refine_poses(self, *_: object) -> bool:
        return False

    def apply_brightness(self, *_: object) -> bool:
        return False


def known_receiver(link: LinkSettings, truths: Truths) -> Receiver:
    """The soft receiver with the true channel.

    Parameters
    ----------
    link
        The link as simulated.
    truths
        Truth of each frame, which must be there before the frame is pushed.
    """
    return soft_receiver(link.signal, link.receive, ignore, lambda _identity: KnownPacket(link, truths))


def true_gain(truth: ArrayTruth, link: LinkSettings) -> float:
    """Gray levels of a wide array with all LEDs on, by the Lambertian lobe of LEDs off the axis.

    Parameters
    ----------
    truth
        Truth of the array in a frame; only its distance is used.
    link
        The link as simulated, with one array.
    """
    place, emitter, sensor = link.channel.arrays[0], link.channel.emitter, link.channel.sensor
    z = truth.distance_m
    cosine = z / np.sqrt(z**2 + place.x_m**2 + place.y_m**2)
    return float(place.brightness * emitter.all_on * cosine**emitter.lobe_order * sensor.full_scale)


def true_noise(gain: float, link: LinkSettings) -> Noise:
    """Noise of a difference of two frames by EMVA 1288: 2 (K^2 sigma_d^2 + 1 / 12) and K times the light of both.

    Parameters
    ----------
    gain
        Gray levels of a wide array with all LEDs on, as `true_gain` gives them.
    link
        The link as simulated.
    """
    sensor, channel = link.channel.sensor, link.channel
    k = sensor.gain_dn_per_e
    # 2 (K^2 sigma_d^2 + 1 / 12)
    dark = 2 * ((k * sensor.dark_noise_e) ** 2 + 1 / 12)
    panel, background = channel.emitter.panel_level, channel.background.level
    return Noise(dark + k * (gain + 2 * panel * sensor.full_scale), dark + k * 2 * background * sensor.full_scale)
