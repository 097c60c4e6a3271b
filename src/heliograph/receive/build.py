"""The receivers "plain" and "soft": two assemblies of the same parts."""

from collections.abc import Callable
from concurrent.futures import Executor
from itertools import count

from heliograph.base.errors import SettingsError
from heliograph.receive.array import ArrayReceiver, PacketReader
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.decode.soft_packet import SoftDecoding
from heliograph.receive.decode.worker import ArrayKey, InlineExecutor, PacketDecoder, ProcessExecutor
from heliograph.receive.detect.alternation import SearchParameters
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import HeaderSearch, around
from heliograph.receive.events import Observer
from heliograph.receive.geometry.pose import pose_of
from heliograph.receive.geometry.view import View
from heliograph.receive.geometry.window import Window
from heliograph.receive.plain_reader import PlainReader
from heliograph.receive.receiver import Parts, StreamReceiver
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft_reader import SoftReader
from heliograph.receive.sync.frame_clock import CameraClock, SynchronousClock
from heliograph.receive.sync.pairing import AsynchronousPairing, Pairing, SynchronousPairing
from heliograph.receive.track.kalman import MotionModel
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

PLAIN_REGULARITY = 0.5
"""Minimum regularity of a detection in step: that of a header is 0.67 or more, of clutter 0 or less."""

SOFT_REGULARITY = 0.15
"""Minimum regularity out of step, where a header alternates unevenly; the light's clock then drops clutter."""

GIVEN_CONTRAST = 0.1
"""Minimum contrast of an array in a given region, as a fraction of `detect.min_contrast`: there is less clutter."""

MakeReader = Callable[[Detection, Tracker], PacketReader]
"""Makes the reader of the first packet of an array."""


def plain_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> StreamReceiver:
    """Assemble the receiver "plain"."""
    return StreamReceiver(plain_parts(signal, settings, observe), observe)


def soft_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> StreamReceiver:
    """Assemble the receiver "soft"."""
    return StreamReceiver(soft_parts(signal, settings, observe), observe)


def plain_parts(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> Parts:
    """Parts of the paper's receiver: a frame for each pattern, in step with the light."""
    form = PacketFormat(signal)
    options = Decoding(settings.decode.algorithm or "max-log", settings.decode.iterations)

    def reader(detection: Detection, tracker: Tracker) -> PacketReader:
        return PlainReader(detection.identity, form, tracker, settings.plain.equaliser, options, observe)

    def pairing(detection: Detection) -> Pairing:
        return SynchronousPairing(detection.start_time_s, detection.time_s, signal)

    parameters = search_parameters(settings, signal, PLAIN_REGULARITY)
    region = _search_region(parameters, settings, signal.side)
    search = HeaderSearch(parameters, signal, synchronous=True, region=region)
    track = _array_factory(signal, settings, observe, pairing, reader)
    return Parts(SynchronousClock(signal.pattern_period_s), search, track, signal)


def soft_parts(
    signal: SignalSettings, settings: ReceiveSettings, observe: Observer, reader: MakeReader | None = None
) -> Parts:
    """Parts of the receiver at the limit of the channel, for a camera of at least a frame for each pattern."""
    _check_signal(signal)

    def pairing(detection: Detection) -> Pairing:
        exposure_s = settings.calibration.exposure_s
        return AsynchronousPairing(
            detection.start_time_s,
            detection.time_s,
            detection.fit.pose,
            detection.identity,
            detection.led_gains,
            signal,
            exposure_s,
            detection.drift,
        )

    parameters = search_parameters(settings, signal, SOFT_REGULARITY, impaired=True)
    search = HeaderSearch(parameters, signal, region=_search_region(parameters, settings, signal.side))
    reader = reader or soft_reader(signal, settings, observe)
    track = _array_factory(signal, settings, observe, pairing, reader)
    return Parts(CameraClock(), search, track, signal)


def soft_reader(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> MakeReader:
    """Return the maker of the soft receiver's readers."""
    form, soft = PacketFormat(signal), settings.soft
    options = Decoding(settings.decode.algorithm or "log-map", settings.decode.iterations)
    decoding = SoftDecoding(options, soft.feedback, soft.led_by_led, soft.combining)

    def reader(detection: Detection, tracker: Tracker) -> PacketReader:
        return SoftReader(detection.identity, form, tracker, decoding, observe)

    return reader


def search_parameters(
    settings: ReceiveSettings, signal: SignalSettings, regularity: float, impaired: bool = False
) -> SearchParameters:
    """Parameters of a receiver's search."""
    detect, blur_px = settings.detect, settings.calibration.blur_px
    given = bool(detect.corners or detect.region)
    # a film may take two cores; a given place has no bound
    cpu_share = 2.0 if detect.cpu_share is None else detect.cpu_share
    return SearchParameters(
        min_side_px=settings.smallest_side_px,
        max_side_px=detect.max_side_px,
        min_contrast=detect.min_contrast * (GIVEN_CONTRAST if given else 1.0),
        score=detect.score,
        regularity=regularity,
        candidates=detect.candidates,
        cpu_share=1e6 if given else cpu_share,
        impaired=impaired,
        all_on=signal.header == "all_on",
        blur_px=blur_px,
        everywhere=given,
        start=pose_of(detect.corners, signal.side, blur_px) if detect.corners else None,
    )


def _search_region(parameters: SearchParameters, settings: ReceiveSettings, side: int) -> Window | None:
    """Return the region of the settings, or about the corners, if given."""
    start = parameters.start
    if start is not None:
        size, (least, most) = side * start.pitch, (parameters.min_side_px, parameters.max_side_px)
        if not least <= size <= most:
            raise SettingsError(
                f"the array at receive.detect.corners is {size:.3g} px a side, and those from {least:g} to {most:g} px "
                f"are looked for: set receive.detect.{'min' if size < least else 'max'}_side_px"
            )
    return settings.detect.region or (None if start is None else around(start, side))


def _array_factory(
    signal: SignalSettings,
    settings: ReceiveSettings,
    observe: Observer,
    pairing: Callable[[Detection], Pairing],
    reader: MakeReader,
) -> Callable[[Detection], ArrayReceiver]:
    """Return the maker of an array's receiver."""
    focal_px = settings.calibration.focal_m / settings.calibration.pixel_m
    executor, decoder, numbers = decode_executor(bool(settings.decode.in_background)), PacketDecoder(), count()

    def track(detection: Detection) -> ArrayReceiver:
        view = View.of(detection.fit.pose, detection.orientation)
        # a shake moves the image by as many of the camera's pixels in every view
        shake_px, view_focal_px = settings.track.acceleration_px / 2**view.level, focal_px / 2**view.level
        model = MotionModel(signal.pattern_period_s, shake_px, view_focal_px)
        tracker = Tracker(signal.side, model)
        viewed = detection.in_view(view)
        key = ArrayKey(detection.identity, detection.orientation, next(numbers))
        return ArrayReceiver(
            viewed,
            pairing(viewed),
            tracker,
            reader(viewed, tracker),
            executor,
            decoder,
            key,
            signal=signal,
            calibration=settings.calibration,
            coast_s=settings.track.coast_patterns * signal.pattern_period_s,
            observe=observe,
            view=view,
        )

    return track


def decode_executor(in_background: bool) -> Executor:
    """Return the executor that decodes packets."""
    if not in_background:
        return InlineExecutor()
    executor = ProcessExecutor()
    executor.submit(_load_modules)
    return executor


def _load_modules() -> None:
    """Import this module, and so the decoder, where the call runs."""


def _check_signal(signal: SignalSettings) -> None:
    for key, value, wanted in (("modulation", signal.modulation, "haar"), ("header", signal.header, "m_sequence")):
        if value != wanted:
            raise SettingsError(
                f'the soft receiver reads signal.{key} = "{wanted}", not "{value}"; set receive.receiver = "plain"'
            )
