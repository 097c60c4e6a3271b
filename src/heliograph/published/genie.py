"""The receivers "genie-zero-forcing" and "genie-mmse": linear equalisers with the true channel, as bounds."""

from collections.abc import Iterator
from functools import partial
from math import floor

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.base.threads import in_one_thread
from heliograph.channel.render import Canvas, add_array, level_of, surroundings_gain
from heliograph.channel.truth import KnownChannel, Truth
from heliograph.receive.decode.codeword import Decoding, decode_llrs
from heliograph.receive.equalise.lmmse import LARGEST_LLR
from heliograph.receive.events import Observer
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import Window, cut_out, window_around
from heliograph.receive.packet import Packet, packet_status
from heliograph.receive.registry import ReceiverPart
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.frame_clock import SynchronousClock
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

LOADING = 1e-7  # relative loading of zero forcing in place of a pseudo-inverse: far pixels are fewer than LEDs
MARGIN_PX = 6.0  # pixels around the array

Shot = tuple[Frame, Truth]
Equaliser = tuple[Window, Floats, Floats]  # window, weights (symbols, pixels) and light without data (pixels,)


class GenieReceiver:
    """Receiver that knows the channel as simulated, but not the data: a bound of linear receivers.

    With the symbols c and the light H of each symbol on each pixel, the difference of a pair is d = H c + o + n: o is
    the light that does not depend on the data, S the covariance of the noise by EMVA 1288. The equaliser

        y = W H^T S^-1 (d - o),  W = (H^T S^-1 H + k I)^-1

    has k = 0 for zero forcing and k = 1 for MMSE. With G = W H^T S^-1 H, y_i has the mean G_ii c_i and the variance v_i
    by the other symbols and the noise, so that the LLR is 2 G_ii y_i / v_i.

    Homographies, times, point-spread function, brightness and faults of LEDs are the true ones, so that detection and
    tracking cannot fail. LEDs of a moving array are drawn as lit for the exposure. Unknown are drops on the windscreen
    and the halo of fog. As for "plain", a frame shows a pattern.
    """

    def __init__(
        self, signal: SignalSettings, settings: ReceiveSettings, _: Observer, known: KnownChannel, *, is_mmse: bool
    ):
        channel = known.settings
        if channel.sensor.gamma != 1 or channel.camera.row_time_s or channel.emitter.shape == "cell":
            raise SettingsError(
                "a genie receiver knows round LEDs, a global shutter and a linear sensor: leave out the settings "
                "channel.emitter.shape, camera.row_time_s and sensor.gamma, or choose another receiver"
            )
        decoding = Decoding(settings.decode.algorithm or "max-log", settings.decode.iterations)
        arrays = range(len(known.identities))
        self._arrays = [_Array(PacketFormat(signal), known, array, decoding, is_mmse) for array in arrays]
        self._latest, self._clock = known.latest, SynchronousClock(signal.pattern_period_s)

    @in_one_thread
    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the latest frame of the simulation; yield the packets it completes; see `Receiver`."""
        for shown in self._clock.push(frame):
            for array in self._arrays:
                yield from array.push((shown, self._latest()))

    @in_one_thread
    def finish(self) -> Iterator[Packet]:
        """End the film: yield the packets in progress; see `Receiver`."""
        list(self._clock.flush())  # checks the rate
        for array in self._arrays:
            yield from array.finish()


class _Array:
    """Packets of an array."""

    def __init__(self, form: PacketFormat, known: KnownChannel, array: int, decoding: Decoding, is_mmse: bool):
        self._form, self._channel, self._array, self._is_mmse = form, known.settings, array, is_mmse
        self._identity, self._decoding = known.identities[array], decoding
        place = known.settings.arrays[array]
        self._start_s, self._scale = place.start_s, 1 + place.clock_ppm * 1e-6
        # column k: s = 2 x - 1 of the LEDs for symbol k alone
        symbols = form.join(np.eye(form.settings.side**2, dtype=np.int8))
        self._modulation = 0.5 * form.luminances(symbols.astype(np.float64)).reshape(len(symbols), -1).T
        self._packet = 0
        self._first: tuple[int, Shot] | None = None  # number and frame of a pattern that waits for the inverse
        self._pairs: dict[int, tuple[Floats, Shot]] = {}  # LLRs and pattern by pair of data
        self._kept: tuple[bytes, Equaliser] | None = None  # of an array at rest

    def push(self, shot: Shot) -> Iterator[Packet]:
        """Take the next frame; yield the packet it completes."""
        signal, middle_s = self._form.settings, shot[1].time_s + 0.5 * self._channel.camera.exposure_s
        pattern = floor((middle_s - self._start_s) / (signal.pattern_period_s * self._scale))
        packet, place = divmod(pattern, signal.packet_patterns)
        if packet != self._packet:
            yield from self.finish()
        pair, is_visible, first = place // 2 - signal.header_pairs, shot[1].arrays[self._array].visible, self._first
        is_first = pattern % 2 == 0 and packet >= 0 and pair >= 0 and is_visible
        self._packet, self._first = packet, (pattern, shot) if is_first else None
        if first is not None and first[0] == pattern - 1 and is_visible:
            self._pairs[pair] = self._read(first[1], shot), first[1]
        if place == signal.packet_patterns - 1:
            yield from self.finish()

    def finish(self) -> Iterator[Packet]:
        """Yield the packet in progress, if any."""
        pairs, self._pairs = self._pairs, {}
        if not pairs:
            return
        form, shots = self._form, [shot for _, shot in pairs.values()]
        llrs = np.zeros((form.settings.data_pairs, form.settings.side**2))
        llrs[[*pairs]] = [values for values, _ in pairs.values()]
        words, seen = decode_llrs(llrs, form, self._identity, self._decoding), len(pairs) / len(llrs)
        status, (frame, truth) = packet_status(words, 1.0, seen), shots[len(shots) // 2]
        start_s = self._start_s + self._packet * form.settings.packet_s * self._scale + frame.time_s - truth.time_s
        first, last, pose = shots[0][0].index, shots[-1][0].index + 1, self._pose(truth)
        distance_m = truth.arrays[self._array].distance_m
        yield Packet(self._identity, status, start_s, first, last, pose, distance_m, 1.0, 1.0, seen, words)

    def _read(self, first: Shot, second: Shot) -> Floats:
        """Compute the LLRs of the symbols of a pair."""
        key = b"".join(truth.arrays[self._array].homography.tobytes() for _, truth in (first, second))
        key += np.array([self._level(truth) for _, truth in (first, second)]).tobytes()
        if self._kept is None or self._kept[0] != key:
            self._kept = key, self._equaliser(first, second)
        window, weights, offset = self._kept[1]
        change = cut_out(first[0], window) - cut_out(second[0], window)
        return np.asarray(np.clip(weights @ (change.ravel() - offset), -LARGEST_LLR, LARGEST_LLR))

    def _equaliser(self, first: Shot, second: Shot) -> Equaliser:
        """Compute the equaliser of a pair, with LLRs as output."""
        (frame, truth), sensor, faults = first, self._channel.sensor, first[1].faults[self._array]
        x, y, width, height = window_around(self._pose(truth), self._form.settings.side, MARGIN_PX)
        left, top = max(x, frame.origin[0]), max(y, frame.origin[1])
        right, low = (frame.origin[k] + frame.pixels.shape[1 - k] for k in (0, 1))
        window = left, top, min(x + width, right) - left, min(y + height, low) - top
        up, down = (self._light(shot[1], window) for shot in (first, second))
        # LEDs shine dark + x (lit - dark) in a pattern, with 1 - x in the inverse
        offset = (up - down) @ (0.5 * (faults.lit + faults.dark).ravel())
        matrix = (up + down) @ (0.5 * (faults.lit - faults.dark).reshape(-1, 1) * self._modulation)
        total = cut_out(frame, window) + cut_out(second[0], window)
        light = 0.5 * total.ravel() - sensor.offset_dn
        noise = sensor.full_scale * truth.noise.sigma(np.maximum(light, 0) / sensor.full_scale)
        weighted = matrix.T / (2 * noise**2)
        gram = weighted @ matrix
        loading = 1.0 if self._is_mmse else LOADING * np.trace(gram) / len(gram)
        inverse = np.linalg.inv(gram + loading * np.eye(len(gram)))
        response = inverse @ gram
        mean = response.diagonal()
        variance = (response**2).sum(1) - mean**2 + (response * inverse).sum(1)
        return window, (2 * mean / variance)[:, None] * (inverse @ weighted), offset

    def _light(self, truth: Truth, window: Window) -> Floats:
        """Return the light of each LED on each pixel in gray levels, (pixels, n n)."""
        seen, (x, y, width, height), side = truth.arrays[self._array], window, self._form.settings.side
        out, zero = np.zeros((side**2, height, width), np.float32), np.zeros((side, side))
        spread = np.full((side, side), self._channel.camera.exposure_s**2 / 12)
        for led, image in enumerate(out):
            light = np.eye(1, side**2, led).reshape(side, side)
            moments = light, zero, spread
            add_array(self._channel, seen.homography, seen.drift, seen.eye, moments, Canvas(image, (x, y)))
        return self._level(truth) * out.reshape(len(out), -1).T.astype(np.float64)

    def _level(self, truth: Truth) -> float:
        """Return the light of the array with all LEDs on, in gray levels."""
        channel, time_s = self._channel, truth.time_s + 0.5 * self._channel.camera.exposure_s
        gain = channel.camera.gain(time_s) * surroundings_gain(channel, time_s)
        return gain * level_of(channel, self._array, time_s) * channel.sensor.full_scale

    def _pose(self, truth: Truth) -> Pose:
        seen = truth.arrays[self._array]
        return Pose(seen.x, seen.y, seen.pitch_px, seen.roll_rad)


ZERO_FORCING = ReceiverPart(partial(GenieReceiver, is_mmse=False), needs_truth=True)
MMSE = ReceiverPart(partial(GenieReceiver, is_mmse=True), needs_truth=True)
