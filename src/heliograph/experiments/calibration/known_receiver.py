"""The soft receiver with the channel known: the true pose, blur, gain and noise in place of estimates.

Only experiments give a receiver the truth; everything else about it is the receiver's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.threads import one_thread
from heliograph.channel import ArrayTruth
from heliograph.experiments.links import true_pose
from heliograph.link.settings import LinkSettings
from heliograph.receive import Receiver
from heliograph.receive.array import PacketReader
from heliograph.receive.build import soft_parts, soft_reader
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.turbo_equaliser import GainAndNoise, decode_iteratively
from heliograph.receive.decode.worker import ArrayState, Decoded
from heliograph.receive.detect.detection import Detection
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.events import Observer, ignore
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import PairStatistics
from heliograph.receive.receiver import StreamReceiver
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader, UnpairedFrame
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.formats import Format
from heliograph.signal.packet import PacketFormat

Truths = dict[int, ArrayTruth]
"""The array's truth by number of the frame."""


class KnownReader:
    """The soft receiver's reader with the true channel in place of the estimated one; see `array.PacketReader`."""

    def __init__(self, link: LinkSettings, truths: Truths, blind: PacketReader):
        self._link, self._truths, self._blind = link, truths, blind
        self._form = PacketFormat(link.signal)
        self._cutouts: list[Cutout | None] = [None] * link.signal.data_pairs
        self._gain = 0.0

    @property
    def format(self) -> Format:
        """The packet's format, as its header signals it."""
        return self._blind.format

    def read_header(self, number: int, pair: FramePair, tracked: TrackedPair) -> tuple[Track, float]:
        """Read a header pair blind; see `PacketReader`."""
        return self._blind.read_header(number, pair, tracked)

    def end_header(self, header: MeasuredHeader) -> None:
        """Nothing: the camera is in step."""

    def follow(self, pair: FramePair, track: Track) -> TrackedPair:
        """Follow the array blind; see `PacketReader`.

        Parameters
        ----------
        pair
            Camera frames of a pair of data.
        track
            The array as it was before this pair.
        """
        return self._blind.follow(pair, track)

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> None:  # noqa: ARG002 - the truth is known
        """Keep a pair with its true poses."""
        first, second = (self._truths[frame.index] for frame in (pair.pattern, pair.inverted))
        poses = true_pose(first, self._link), true_pose(second, self._link)
        self._cutouts[place] = take_cutout(pair, poses, self._link.signal.side)
        self._gain = true_gain(first, self._link)

    def add_unpaired(self, place: int, lone: UnpairedFrame) -> None:
        """Leave a pair out of which one frame is lost; see `PacketReader`."""

    def observations(self) -> "KnownPairs":
        """The cut-outs of all pairs, with the gain; see `PacketReader`."""
        return KnownPairs(self._link, self._form, tuple(self._cutouts), self._gain)

    def next(self, state: ArrayState | None, confirmed: bool) -> "KnownReader":
        """Make the reader of the next packet; see `PacketReader`."""
        return KnownReader(self._link, self._truths, self._blind.next(state, confirmed))

    def update(self, state: ArrayState) -> None:
        """Ignore the array's state: all is known; see `PacketReader`."""


@dataclass(frozen=True, slots=True)
class KnownPairs:
    """What was taken of a packet whose channel is known; see `worker.Observations`."""

    # The link as simulated, with one array at rest in step
    link: LinkSettings
    # Format of the packet
    form: PacketFormat
    # Cut-outs of its pairs at their true poses; None for pairs not seen
    cutouts: tuple[Cutout | None, ...]
    # Gray levels of the array with all LEDs on
    gain: float

    def has_codeword(self) -> bool:
        """Return False: no check is faster than decoding; see `Observations`."""
        return False

    def renumbered(self, place: int) -> "KnownPairs":  # noqa: ARG002 - no frame is lost
        """The same: no frame is lost of which the truth is known; see `Observations`."""
        return self

    @one_thread()
    def decode(self, state: ArrayState, observe: Observer, /) -> Decoded:  # noqa: ARG002 - the protocol's
        """Codewords by layer.

        Parameters
        ----------
        state
            State of the array; ignored.
        observe
            Gets nothing: no event tells of this decoding.
        """
        noise, receive = true_noise(self.gain, self.link), self.link.receive
        observed = ObservedPacket.of(self.cutouts, noise, self.form, LedGains.sound(self.link.signal.side))
        channel, decoding = GainAndNoise(self.gain, noise.lit), Decoding("log-map", receive.decode.iterations)
        identity = self.link.transmit.identities[0]
        return Decoded(decode_iteratively(_FixedPoses(observed), channel, self.form, identity, decoding, None).words)


@dataclass(frozen=True, slots=True)
class _FixedPoses:
    """Pairs whose poses are right already."""

    observed: ObservedPacket

    @property
    def statistics(self) -> Sequence[PairStatistics | None]:
        return self.observed.statistics

    def refined(self, mean: Floats, variance: Floats, gain: float, noise: float) -> "_FixedPoses":  # noqa: ARG002 - the protocol's
        return self

    def with_led_brightness(self, mean: Floats, variance: Floats, gain: float, noise: float) -> "_FixedPoses":  # noqa: ARG002 - the protocol's
        return self


def known_receiver(link: LinkSettings, truths: Truths) -> Receiver:
    """The soft receiver with the true channel."""
    blind = soft_reader(link.signal, link.receive, ignore)

    def reader(detection: Detection, tracker: Tracker) -> PacketReader:
        return KnownReader(link, truths, blind(detection, tracker))

    return StreamReceiver(soft_parts(link.signal, link.receive, ignore, reader), ignore)


def true_gain(truth: ArrayTruth, link: LinkSettings) -> float:
    """Gray levels of a wide array with all LEDs on, by the Lambertian lobe of LEDs off the axis."""
    place, emitter, sensor = link.channel.arrays[0], link.channel.emitter, link.channel.sensor
    z = truth.distance_m
    cosine = z / np.sqrt(z**2 + place.x_m**2 + place.y_m**2)
    return float(place.brightness * emitter.all_on * cosine**emitter.lobe_order * sensor.full_scale)


def true_noise(gain: float, link: LinkSettings) -> Noise:
    """Noise of a difference of two frames by EMVA 1288: 2 (K^2 sigma_d^2 + 1 / 12) and K times the light of both."""
    sensor, channel = link.channel.sensor, link.channel
    k = sensor.gain_dn_per_e
    # 2 (K^2 sigma_d^2 + 1 / 12)
    dark = 2 * ((k * sensor.dark_noise_e) ** 2 + 1 / 12)
    panel, background = channel.emitter.panel_level, channel.background.level
    return Noise(dark + k * (gain + 2 * panel * sensor.full_scale), dark + k * 2 * background * sensor.full_scale)
