"""The receivers "plain" and "soft": two assemblies of the same parts."""

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from itertools import count
from typing import Any

from heliograph.base.errors import SettingsError
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.header_reader import HeaderReader
from heliograph.receive.decode.per_led import PlainPacket, ReadPair, pair_luminances
from heliograph.receive.decode.soft_packet import SoftPacket
from heliograph.receive.decode.worker import PacketDecoder, PacketObservations, call_in_process, call_inline
from heliograph.receive.detect.alternation import SearchParameters
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import HeaderSearch, around
from heliograph.receive.events import Observer
from heliograph.receive.geometry.pose import pose_of
from heliograph.receive.geometry.view import View
from heliograph.receive.receiver import StreamReceiver
from heliograph.receive.settings import ReceiveSettings, check_pairs
from heliograph.receive.sync.frame_clock import CameraClock, FrameClock, SynchronousClock
from heliograph.receive.sync.pairing import AsynchronousPairing, Pairing, SynchronousPairing
from heliograph.receive.track.kalman import MotionModel
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

# minimum regularity of a detection in step: that of a header is 0.67 or more, of clutter 0 or less
PLAIN_REGULARITY = 0.5

# the same out of step, where a header alternates unevenly; the light's clock then drops clutter
SOFT_REGULARITY = 0.15

MakePacket = Callable[[int], PacketObservations]  # makes the observations of a packet, by the identity of the array


def plain_receiver(
    signal: SignalSettings, settings: ReceiveSettings, observe: Observer, read: ReadPair | None = None
) -> StreamReceiver:
    """Assemble the paper's receiver: a frame for each pattern, in step with the light."""
    options = Decoding(settings.decode.algorithm or "max-log", settings.decode.iterations)

    def pairing(detection: Detection) -> Pairing:
        return SynchronousPairing(detection.start_time_s, detection.time_s, detection.identity, signal)

    read = read or partial(pair_luminances, side=signal.side, equaliser=settings.plain.equaliser)
    make_packet = partial(PlainPacket, form=PacketFormat(signal), read=read, options=options)
    clock = SynchronousClock(signal.pattern_period_s)
    return _assemble(signal, settings, observe, clock, pairing, make_packet, is_plain=True)


def soft_receiver(
    signal: SignalSettings, settings: ReceiveSettings, observe: Observer, make_packet: MakePacket | None = None
) -> StreamReceiver:
    """Assemble the receiver at the limit of the channel, for a camera of at least a frame for each pattern."""
    check_pairs(signal, "soft")
    decode, soft = settings.decode, settings.soft
    options = Decoding(decode.algorithm or "log-map", decode.iterations, soft.feedback, soft.led_by_led, soft.combining)

    def pairing(detection: Detection) -> Pairing:
        header = detection.start_time_s, detection.time_s, detection.fit.pose, detection.identity, detection.led_gains
        return AsynchronousPairing(*header, signal, settings.calibration.exposure_s, detection.drift)

    make_packet = make_packet or partial(SoftPacket, signal=signal, options=options)
    return _assemble(signal, settings, observe, CameraClock(), pairing, make_packet)


def search_parameters(settings: ReceiveSettings, signal: SignalSettings, impaired: bool = False) -> SearchParameters:
    """Parameters of the search of "plain", or if arrays may be impaired, of "soft"."""
    detect, blur_px = settings.detect, settings.calibration.blur_px
    given = bool(detect.corners or detect.region)
    return SearchParameters(
        min_side_px=settings.smallest_side_px,
        max_side_px=detect.max_side_px,
        # there is less clutter in a given region
        min_contrast=detect.min_contrast * (0.1 if given else 1.0),
        score=detect.score,
        regularity=SOFT_REGULARITY if impaired else PLAIN_REGULARITY,
        candidates=detect.candidates,
        # a given place has no bound; a film may take two cores
        cpu_share=1e6 if given else detect.cpu_share or 2.0,
        impaired=impaired,
        all_on=signal.header == "all_on",
        blur_px=blur_px,
        everywhere=given,
        start=pose_of(detect.corners, signal.side, blur_px) if detect.corners else None,
    )


def _header_search(settings: ReceiveSettings, signal: SignalSettings, synchronous: bool) -> HeaderSearch:
    """Return the search in the region of the settings, or about the corners, if given."""
    parameters = search_parameters(settings, signal, impaired=not synchronous)
    start, region = parameters.start, settings.detect.region or None
    if start is not None:
        size, (least, most) = signal.side * start.pitch, (parameters.min_side_px, parameters.max_side_px)
        if not least <= size <= most:
            raise SettingsError(
                f"the array at receive.detect.corners is {size:.3g} px a side, and those from {least:g} to {most:g} px "
                f"are looked for: set receive.detect.{'min' if size < least else 'max'}_side_px"
            )
        region = region or around(start, signal.side)
    return HeaderSearch(parameters, signal, synchronous, region)


def _assemble(
    signal: SignalSettings,
    settings: ReceiveSettings,
    observe: Observer,
    clock: FrameClock,
    pairing: Callable[[Detection], Pairing],
    make_packet: MakePacket,
    is_plain: bool = False,
) -> StreamReceiver:
    """Assemble a receiver of a clock, a search and the tracks of arrays."""
    search = _header_search(settings, signal, synchronous=is_plain)
    focal_px = settings.calibration.focal_m / settings.calibration.pixel_m
    submit, decoder, numbers = decode_executor(bool(settings.decode.in_background)), PacketDecoder(), count()
    make = partial(ArrayReceiver, submit=submit, decoder=decoder, signal=signal, settings=settings, observe=observe)

    def track(detection: Detection) -> ArrayReceiver:
        view, identity = View.of(detection.fit.pose, detection.orientation), detection.identity
        # a shake moves the image by as many of the camera's pixels in every view
        shake_px, view_focal_px = settings.track.acceleration_px / 2**view.level, focal_px / 2**view.level
        viewed, key = detection.in_view(view), (identity, detection.orientation, next(numbers))
        tracker = Tracker(signal.side, MotionModel(signal.pattern_period_s, shake_px, view_focal_px))
        headers, packets = HeaderReader(identity, signal, is_plain), partial(make_packet, identity)
        return make(viewed, pairing(viewed), tracker, headers, packets, key=key, view=view)

    return StreamReceiver(clock, search, track, observe)


def decode_executor(in_background: bool) -> Callable[..., Future[Any]]:
    """Return the function that runs a call of the decoder and returns the future result."""
    if not in_background:
        return call_inline
    call_in_process(_load_modules)
    return call_in_process


def _load_modules() -> None:
    """Import this module, and so the decoder, where the call runs."""
