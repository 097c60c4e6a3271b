"""The receiver "screen": one array of a screen, found where everything changes, followed, and read row by row."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame, check_next
from heliograph.base.threads import in_one_thread
from heliograph.receive.acquire.detection import Detection
from heliograph.receive.coming import ENOUGH_SEEN, HEADER_SEEN
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.events import DecodeEvent, DetectEvent, LostEvent, Observer
from heliograph.receive.image.fit import Fit
from heliograph.receive.image.pose import Pose
from heliograph.receive.packets import Packet, Status
from heliograph.receive.screen.follow import Follower, Sample
from heliograph.receive.screen.grid import RIM_CELLS, Look, Place, inside
from heliograph.receive.screen.outline import Pixels32, changing, quadrilaterals, reduced, sharpened
from heliograph.receive.screen.reader import PacketReading, ReadPacket
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

KEPT_FRAMES = 64
"""Frames that are kept while an array is looked for: 2 s at 30 frames a second, 16 patterns of 60 a second at 240. They
take 60 MB at 1280 x 720."""

SEARCH_EVERY = 6
"""Frames from one search to the next. Chosen: a fifth of a second at 30 frames a second."""

FIRST_SEARCH = 12
"""Frames before the first search: four patterns at three frames a pattern."""

WINDOWS = (8, 16, 64)
"""Latest frames whose changes are looked at: few, as a hand moves the array meanwhile; many, where patterns are
slow."""

BLURS_PX = (1.0, 0.6, 1.6, 2.4)
"""Blurs that are tried in px."""

WIDEST = 0.45
"""Largest blur that is tried in cells: a wider one lets cells explain anything."""

VAIN = 4
"""Thorough searches in vain after which they become rarer: each takes a second. Chosen."""

TRIED = 8
"""Best places of one frame that are tried in several."""

DOUBTFUL = 0.3
"""Misfit, and change of the ring by that of the array, above which other places are tried: of an array in its place
both are 0.06 to 0.25 together."""

SWAY_PX = 14.0
"""Px by which an array may seem larger. Chosen: a hand moves a phone's picture by about 8 px in 0.25 s at most."""

SMALLEST = 0.75
"""Least scale that is tried. Chosen."""

SCALES = 0.9
"""Cells from one size that is tried to the next: the fit finds one that is half a cell off at either edge."""

TRIAL_FRAMES = 8
"""Frames in which a place is tried. Chosen: two to four patterns, at 30 frames a second."""

SETTLING = 10
"""Most steps of a place that is tried. Chosen: it may be a cell off."""

LOST_S = 1.0
"""Seconds out of sight after which an array is looked for anew. Chosen."""


def screen_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> "ScreenReceiver":
    """Make the receiver "screen".

    Parameters
    ----------
    signal
        Settings of the light's signal, on which both ends agree; the pattern rate is a first guess alone.
    settings
        Settings of the receiver: those of the decoder, of calibration and of "screen" count.
    observe
        Gets the events of arrays found and lost, and of packets decoded.

    Raises
    ------
    SettingsError
        The light does not use the hierarchical code, or its headers have no M-sequence.
    """
    if signal.modulation != "haar" or signal.header != "m_sequence":
        raise SettingsError('the receiver screen reads signal.modulation = "haar" with signal.header = "m_sequence"')
    return ScreenReceiver(signal, settings, observe)


@dataclass(frozen=True)
class Sight:
    """What a receiver sees of the array that it follows, for those who ask why nothing is read.

    Attributes
    ----------
    cell_px
        Mean side of a cell in px.
    blur_px
        Standard deviation of the blur in px by which the cells fit best.
    misfit
        Rms of what the cells do not explain, as a part of the picture's contrast.
    saturated
        Part of the array that is at full scale.
    clocked
        Whether the light's clock is known.
    """

    cell_px: float
    blur_px: float
    misfit: float
    saturated: float
    clocked: bool


@dataclass(frozen=True)
class _Placed:
    """What may be an array: how badly its cells fit, where it is in the latest frames but a few, and by which blur."""

    score: float
    place: Place
    look: Look


@dataclass(frozen=True)
class _Taken:
    """An array that is followed."""

    follower: Follower
    samples: list[Sample]


class ScreenReceiver:
    """Finds the array of a screen in a stream of frames and yields its packets; see `packets.Receiver`.

    Parameters
    ----------
    signal, settings, observe
        The light's signal, settings of the receiver and an observer, as of `screen_receiver`.
    """

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, observe: Observer):
        self._signal, self._settings, self._observe = signal, settings, observe
        self._options = Decoding(settings.decode.algorithm or "log-map", settings.decode.iterations)
        self._frames: deque[Frame] = deque(maxlen=KEPT_FRAMES)
        self._small: deque[Pixels32] = deque(maxlen=KEPT_FRAMES)
        self._factor = 1
        self._since = self._vain = 0
        self._last: Frame | None = None
        self._light: NDArray[np.float32] | None = None
        self._follower: Follower | None = None
        self._reading: PacketReading | None = None
        self._identity: int | None = None
        self._sample: Sample | None = None
        self._periods: deque[float] = deque(maxlen=KEPT_FRAMES)

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes; see `Receiver`.

        Raises
        ------
        HeliographError
            It is no frame, or one of another camera than the last.
        """
        return in_one_thread(self._checked(frame))

    def finish(self) -> Iterator[Packet]:
        """End of the film: yield the packet in progress if enough of it was seen."""
        return in_one_thread(self._finish())

    @property
    def sight(self) -> Sight | None:
        """What is seen of the array that is followed; None where none is."""
        if self._follower is None or self._reading is None or self._sample is None:
            return None
        seen = self._sample.seen
        cell = seen.place.cell_px(self._signal.side)
        return Sight(cell, self._follower.blur_px, seen.misfit, seen.saturated, self._reading.clocked)

    def _finish(self) -> Iterator[Packet]:
        if self._follower is None and len(self._frames) >= FIRST_SEARCH:
            yield from self._search()
        if self._reading is not None:
            for one in self._reading.finish():
                yield self._packet(one)
        self._forget()

    def _checked(self, frame: Frame) -> Iterator[Packet]:
        check_next(frame, self._last)
        last, self._last = self._last, frame
        if last is not None:
            # a copy of the frame before shows nothing new
            if frame.pixels.shape == last.pixels.shape and np.array_equal(frame.pixels, last.pixels):
                return
            self._periods.append((frame.time_s - last.time_s) / max(frame.index - last.index, 1))
        if self._follower is not None:
            yield from self._follow(frame)
        if self._follower is None:
            self._frames.append(frame)
            small, self._factor = reduced(self._linear(frame))
            self._small.append(small)
            self._since += 1
            if len(self._frames) >= FIRST_SEARCH and self._since >= SEARCH_EVERY:
                self._since = 0
                yield from self._search()

    def _linear(self, frame: Frame) -> Pixels32:
        if self._light is None:
            levels = np.arange(frame.full_scale + 1) / frame.full_scale
            self._light = (levels**self._settings.screen.gamma).astype(np.float32)
        linear: Pixels32 = self._light[frame.pixels]
        return linear

    @property
    def _frame_s(self) -> float:
        return float(np.median(self._periods))

    def _search(self) -> Iterator[Packet]:
        """Look for an array in the frames kept."""
        for count in WINDOWS:
            if count > 2 * len(self._small):
                return
            latest = list(self._small)[-count:]
            changes = changing(latest)
            places = quadrilaterals(changes, self._factor)
            tried = sorted((self._placed(one, count) for one in places), key=lambda one: one.score)
            if tried and DOUBTFUL < tried[0].score < np.inf and not self._hopeless():
                tried = [self._searched(tried[0]), *tried]
            for one in tried:
                taken = self._whole(one) if np.isfinite(one.score) else None
                if taken is not None:
                    yield from self._take_up(taken)
                    return

    def _placed(self, corners: Floats, count: int) -> _Placed:
        """Where what may be an array fits best, and how well."""
        frames = list(self._frames)
        middle = max(len(frames) - TRIAL_FRAMES, 0)
        latest = frames[-count:]
        linear = [self._linear(one) for one in latest[:: max(1, len(latest) // 16)]]
        sharp = sharpened(changing(linear), corners, self._factor)
        assert self._light is not None
        looks = [Look(self._signal.side, blur, self._light) for blur in BLURS_PX]
        some = frames[middle : middle + TRIAL_FRAMES]
        starts = [Place.of(one, self._signal.side) for one in (sharp, corners)]
        best = min((self._trial(looks[0], one, some) for one in starts), key=lambda one: one[0])
        cell = best[1].cell_px(self._signal.side)
        tried = [_Placed(*self._trial(one, best[1], some), one) for one in looks if one.blur_px < WIDEST * cell]
        return min(tried, key=lambda one: one.score, default=_Placed(*best, looks[0]))

    def _hopeless(self) -> bool:
        """Whether too much was tried in vain of late."""
        self._vain += 1
        return self._vain > VAIN and self._vain & (self._vain - 1) != 0

    def _searched(self, placed: _Placed) -> _Placed:
        """The best of many places about one: a hand that sways makes an array seem larger."""
        look, place = placed.look, placed.place
        frames = list(self._frames)[max(len(self._frames) - TRIAL_FRAMES, 0) :]
        n, (wide, high) = self._signal.side, _motion(place, self._signal.side, self._factor)
        found: list[tuple[float, Place]] = []
        for x, y in product(np.arange(1.0, wide, -SCALES / n), np.arange(1.0, high, -SCALES / n)):
            for right, down in product((0.0, 0.5), (0.0, 0.5)):
                one = place.scaled(x, y, n).shifted(right, down)
                if inside(one, n, frames[0].pixels.shape):
                    seen = look(frames[0].pixels, one, SETTLING)
                    found.append((seen.misfit, seen.place))
        found.sort(key=lambda one: one[0])
        tried = [_Placed(*self._trial(look, one, frames), look) for _, one in found[:TRIED]]
        return min((placed, *tried), key=lambda one: one.score)

    def _trial(self, look: Look, place: Place, frames: list[Frame]) -> tuple[float, Place]:
        """How well cells fit some frames from a place on, and where they are in the first of them."""
        try:
            start = look(frames[0].pixels, place, SETTLING).place
        except np.linalg.LinAlgError:
            return np.inf, place
        follower = Follower(look, start, firm=False)
        seen = [one for one in map(follower.take, frames) if one is not None]
        if len(seen) < len(frames):
            return np.inf, start
        change = np.stack([one.seen.cells for one in seen]).std(axis=0)
        inner = change[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]
        ring = (change.sum() - inner.sum()) / (change.size - inner.size)
        # beside the array nothing changes
        return float(np.mean([one.seen.misfit for one in seen]) + ring / max(float(inner.mean()), TINY)), start

    def _whole(self, placed: _Placed) -> _Taken | None:
        """Follow an array back to the first frame kept and on to the last; shift it where a rim does not change."""
        frames, look, start = list(self._frames), placed.look, placed.place
        middle = max(len(frames) - TRIAL_FRAMES, 0)
        for _ in range(3):
            back = Follower(look, start)
            before = [back.take(one) for one in frames[middle::-1]]
            ahead = Follower(look, start)
            after = [ahead.take(one) for one in frames[middle + 1 :]]
            samples = [one for one in (*before[::-1], *after) if one is not None]
            if len(samples) < len(frames) // 2:
                return None
            shift = rim_shift(np.stack([one.seen.cells for one in samples]))
            if not any(shift):
                return _Taken(ahead, samples)
            start = start.shifted(*shift)
        return None

    def _take_up(self, taken: _Taken) -> Iterator[Packet]:
        self._follower = taken.follower
        shape = self._frames[-1].pixels.shape
        screen = self._settings.screen
        self._reading = PacketReading(
            self._signal, self._options, self._frame_s, shape, screen.row_time_s, not screen.find_rate
        )
        for sample in taken.samples:
            yield from self._read(sample)

    def _follow(self, frame: Frame) -> Iterator[Packet]:
        assert self._follower is not None
        sample = self._follower.take(frame)
        self._frames.append(frame)
        if sample is not None:
            yield from self._read(sample)
        elif self._follower.lost_since is not None and frame.time_s - self._follower.lost_since > LOST_S:
            if self._reading is not None:
                for one in self._reading.finish():
                    yield self._packet(one)
            self._forget()

    def _read(self, sample: Sample) -> Iterator[Packet]:
        assert self._reading is not None
        self._sample = sample
        for one in self._reading.take(sample):
            yield self._packet(one)

    def _forget(self) -> None:
        if self._identity is not None and self._last is not None:
            self._observe(LostEvent(self._identity, self._last.time_s))
        self._follower = self._reading = self._identity = None
        self._frames.clear()
        self._small.clear()

    def _packet(self, one: ReadPacket) -> Packet:
        pose = _pose(one.first.seen.place, self._signal.side)
        if self._identity is None:
            self._observe(DetectEvent(self._detection(one, pose), tuple(self._frames)[-1:]))
            self._identity = one.header.identity
        known = self._settings.calibration
        packet = Packet(
            identity=one.header.identity,
            status=_status(one),
            start_time_s=one.start_s,
            first_frame=one.first.index,
            last_frame=one.last.index,
            pose=pose,
            # pinhole: pitch_px = f p / (Z pixel)
            distance_m=known.focal_m * known.pitch_m / (pose.frontal_pitch * known.pixel_m),
            header_score=one.header.score,
            track_score=float(np.clip(1 - one.first.seen.misfit**2, 0, 1)),
            pairs_seen=float(np.mean(one.seen)),
            layers=one.words,
            format=one.form,
            orientation=one.header.orientation,
            reason=one.reason,
        )
        self._observe(DecodeEvent(packet.identity, packet, luminances=one.change))
        return packet

    def _detection(self, one: ReadPacket, pose: Pose) -> Detection:
        side = self._signal.side
        light = float(one.first.seen.light.mean()) * self._last.full_scale if self._last else 0.0
        fit = Fit(pose.full_vector(), np.eye(7), light, 1 - one.first.seen.misfit)
        return Detection(
            one.header.identity,
            one.start_s,
            fit,
            one.start_s,
            one.header.score,
            1.0,
            np.ones((side, side)),
            one.header.orientation,
        )


def _motion(place: Place, side: int, factor: int) -> tuple[float, float]:
    """Least scales, across and down, of an array that seems larger by the motion of a hand."""
    size = max(place.cell_px(side) * side, 1.0)
    least = max(1 - (SWAY_PX + factor) / size, SMALLEST)
    return least, least


def rim_shift(cells: Floats) -> tuple[int, int]:
    """Return by how many cells, right and down, an array lies beside where it is taken for.

    Parameters
    ----------
    cells
        (frames, n + 2, n + 2) light of the cells and the ring around them.
    """
    change = cells.std(axis=0)
    typical = float(np.median(change[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]))
    inner = slice(RIM_CELLS, -RIM_CELLS)
    lines = {
        "left": (change[inner, 0], change[inner, 1]),
        "right": (change[inner, -1], change[inner, -2]),
        "top": (change[0, inner], change[1, inner]),
        "low": (change[-1, inner], change[-2, inner]),
    }
    outer = {name: float(np.median(a)) > typical / 2 for name, (a, _) in lines.items()}
    dark = {name: float(np.median(b)) < typical / 4 for name, (_, b) in lines.items()}
    across = int(outer["right"] and dark["left"]) - int(outer["left"] and dark["right"])
    down = int(outer["low"] and dark["top"]) - int(outer["top"] and dark["low"])
    return across, down


def _pose(place: Place, side: int) -> Pose:
    """The affine pose at an array's middle."""
    middle = np.array([side / 2, side / 2])
    x, y = place.at(middle)
    right, down = (place.at(middle + d) - place.at(middle - d) for d in np.eye(2) / 2)
    a = np.column_stack([right, down])
    u, sizes, vt = np.linalg.svd(a)
    turn, stretch = u @ vt, vt.T @ np.diag(sizes / sizes.mean()) @ vt
    roll = float(np.arctan2(turn[1, 0], turn[0, 0]))
    return Pose(float(x), float(y), float(sizes.mean()), roll, 0.6, float(stretch[0, 0] - 1), float(stretch[0, 1]))


def _status(one: ReadPacket) -> Status:
    good = [word.status == "ok" for words in one.words.values() for word in words]
    if any(good):
        return "ok" if all(good) else "partial"
    if np.mean(one.seen) < ENOUGH_SEEN:
        return "no_array"
    return "crc_fail" if one.header.score >= HEADER_SEEN else "no_header"
