"""Demonstration: the paper's drive simulated, received, and shown as a page."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.base.config import from_mapping
from heliograph.base.errors import HeliographError
from heliograph.base.files import write_whole
from heliograph.base.frames import Frame
from heliograph.channel.background import draw_street
from heliograph.experiments import plots
from heliograph.experiments.demo.animation import Filmed, animated, is_picture, pixels_of
from heliograph.experiments.report import Report
from heliograph.link.film import frames_of, sent_s, write_film
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, Recordings
from heliograph.link.truth import TruthFile, open_truth, truth_path
from heliograph.measure.errors import BIN_M
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import open_film
from heliograph.receive import Pose
from heliograph.receive.events import DetectEvent, Event, ExtractEvent, TrackEvent
from heliograph.receive.geometry.window import AnyFrame, cut_out
from heliograph.road.codec import Values, is_there, kind_of, mapem, road_values, road_words, updates
from heliograph.road.junction import Junction, example
from heliograph.signal.message import Message, Updates
from heliograph.signal.settings import LAYERS
from heliograph.transmit import Content

ASPHALT, STRIPES = "#d9dde2", "#9aa1a8"
LIGHTS = {
    "red": "#d0342c", "red-yellow": "#e0862a", "yellow": "#e0b02a", "flashing": "#e0b02a", "green": "#2f9d4a",
    "green-free": "#2f9d4a",
}  # fmt: skip
"""Colour of what a light shows."""


def junction_picture(junction: Values, groups: Mapping[int, Mapping[str, Any]]) -> Figure:
    """Draw a junction."""
    figure = Figure(figsize=(7.5, 6.2))
    axes = figure.subplots()
    # Width of a line by the lane's width in m, as the picture is scaled. Chosen by eye
    width = 3.2 * (junction["lane_width_m"] or 3.0)
    for lane in junction["lanes"]:
        if not lane["points_m"]:
            continue
        x, y = zip(*lane["points_m"], strict=True)
        crossing = lane["kind"] == "crosswalk"
        style = {"color": STRIPES, "ls": (0, (0.5, 0.5))} if crossing else {"color": ASPHALT, "solid_capstyle": "butt"}
        axes.plot(x, y, lw=width, **style, zorder=2 if crossing else 1)
        group = next((groups[number] for number in lane["groups"] if number in groups), None)
        if group is not None:
            colour = LIGHTS.get(group["phase"], plots.GRAY)
            axes.plot(x, y, color=colour, lw=2.2, zorder=3)
            axes.plot(x[0], y[0], "o", color=colour, ms=13, zorder=4)
            left = "" if group["left_s"] is None else f" {max(group['left_s'], 0.0):.0f} s"
            upright = abs(y[0]) > abs(x[0])
            place = ((x[0] + x[-1]) / 2, (y[0] + y[-1]) / 2)
            words = f"{group['phase']}{left}"
            if upright:
                axes.annotate(words, place, (24, 0), textcoords="offset points", va="center")
            else:
                axes.annotate(words, place, (0, 24), textcoords="offset points", ha="center", va="center")
    name = str(junction["name"] or f"junction {junction['id']}").replace("$", r"\$")  # no formula
    axes.set(aspect="equal", xlabel="east (m)", ylabel="north (m)", title=name)
    plots.tidy(axes)
    figure.tight_layout()
    return figure


@dataclass(slots=True)
class TrackRecorder:
    """Observer that keeps the track and some pairs of frames of the array that was found first."""

    # Numbers of the frames from which on the next pair is kept; those done are taken out
    moments: list[int]
    # Time in s, number of the first frame and pose of each pair
    track: list[tuple[float, int, Pose]] = field(default_factory=list)
    # Number of the first frame, pose and both frames of the pairs kept
    cuts: list[tuple[int, Pose, Frame, Frame]] = field(default_factory=list)
    # Number of that array, 0 to 29; None before it is found
    identity: int | None = None

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, DetectEvent) and self.identity is None:
            self.identity = event.detection.identity
        if isinstance(event, TrackEvent) and event.identity == self.identity:
            state = event.tracked.state
            self.track.append((state.time_s, event.frame, state.pose))
        if isinstance(event, ExtractEvent) and event.identity == self.identity:
            self._cut(event)

    def _cut(self, event: ExtractEvent) -> None:
        pattern, inverted = event.frames
        # combined frames show the array's surroundings alone
        if not isinstance(pattern, Frame) or not isinstance(inverted, Frame):
            return
        if self.moments and pattern.index >= self.moments[0]:
            self.moments.pop(0)
            self.cuts.append((pattern.index, event.poses[0], pattern, inverted))


CUT_PX = 64
"""Side of a cut-out in px."""


def write_page(
    path: Path,
    truth: TruthFile,
    shown: tuple[TrackRecorder, bytes],
    reception: Reception,
    counts: Mapping[str, Any],
    messages: Sequence[Message],
) -> None:
    """Write the page, whole or not at all."""
    settings, (recorder, moving) = truth.settings, shown
    page = Report("Heliograph: a drive past an LED array")
    channel = settings.channel
    side = settings.signal.side
    page.text(
        f"A {side} x {side} LED array sends to a {channel.camera.fps:.0f} fps camera behind the windscreen of a car "
        f"driving from {channel.distance_m:.0f} m to {channel.stop_m:.0f} m at {channel.speed_m_s * 3.6:.0f} km/h. "
        f"The film is simulated; the receiver gets its frames alone. {counts['frames']} frames were read at "
        f"{counts['frames_per_second']:.0f} frames/s."
    )
    page.badges(_badges(counts, reception))
    if moving:
        page.heading("The drive, as it was received")
        caption = "Left: the array where it is tracked, packet by packet. Right: the picture that the low layer sends. "
        page.picture(moving, f"{caption}Below: distance, codewords read of each layer, the lights counted down.")
    if recorder.cuts:
        _show_frames(page, recorder)
    _show_messages(page, messages, reception)
    if recorder.cuts:
        if recorder.identity in settings.transmit.identities:
            _show_track(page, truth, recorder)
        _show_cuts(page, recorder)
    _show_errors(page, reception)
    page.write(path)


def _badges(counts: Mapping[str, Any], reception: Reception) -> Iterator[tuple[str, str]]:
    """Codewords read by array and layer, and false ones: green where all is well."""
    for array in counts["arrays"]:
        for name, one in array["layers"].items():
            sent = one["ok"] + one["failed"]
            word = "holds" if not one["failed"] else "shown"
            yield word, f"array {array['id']}, {name}: {one['ok']} of {sent} codewords read"
    if reception.errors is not None:
        false = reception.errors.false_codewords
        yield ("differs" if false else "holds"), f"taken for right, but not sent: {false}"


def _show_messages(page: Report, messages: Sequence[Message], reception: Reception) -> None:
    page.heading("What arrived")
    rows = [(message, road_values(message.data)) for message in messages]
    for identity in sorted({message.identity for message in messages}):
        _show_road(page, identity, [values for message, values in rows if values and message.identity == identity])
    pictures = sorted((len(one.data), one.identity) for one in messages if is_picture(one.data))
    largest = {identity: size for size, identity in pictures}
    for message, values in rows:
        # of the same picture the best is shown
        if values is not None or (is_picture(message.data) and len(message.data) < largest[message.identity]):
            continue
        page.text(f"Array {message.identity}, {message.layer} priority, {len(message.data)} bytes:")
        if is_picture(message.data) and pixels_of(message.data) is not None:
            page.picture(message.data, "a camera's picture of the junction, sent with low priority")
        else:
            page.code(message.data.decode("utf-8", "replace"))
    for identity, layer, _, had, size in reception.unfinished():
        page.text(f"Array {identity}, {layer} priority: {had} of {size} bytes, not complete.", note=True)
    if not messages:
        page.text("No message is complete.")


def _show_road(page: Report, identity: int, values: Sequence[Values]) -> None:
    """The junction as its map has it, its lanes in the colours of its lights; and what was said of those."""
    lights = [one for one in values if one["kind"] == "SPATEM"]
    maps = [one for one in values if one["kind"] == "MAPEM" and one["junctions"]]
    if maps:
        groups = {g["group"]: g for one in lights[-1:] for j in one["junctions"] for g in j["groups"]}
        caption = f"Array {identity}, middle priority: the junction's lanes, a MAPEM; lights as the last "
        page.figure(junction_picture(maps[-1]["junctions"][0], groups), f"{caption}SPATEM told, with high priority.")
    if lights:
        page.text(f"Array {identity}, high priority, {len(lights)} SPATEMs, of which the first and the last:")
        page.code("\n".join(road_words(one) for one in (lights[0], lights[-1])))


def _show_frames(page: Report, recorder: TrackRecorder) -> None:
    page.heading("What the camera saw")
    for which, (_, pose, frame, _) in (("far", recorder.cuts[0]), ("near", recorder.cuts[-1])):
        title = f"{which}: frame {frame.index}, {pose.pitch:.2f} px from LED to LED"
        half = 11 * pose.pitch
        figure = plots.frame_with_array(frame.pixels, pose.x, pose.y, half, title, frame.full_scale)
        page.figure(figure, f"Received image, {which}.")


def _show_track(page: Report, truth: TruthFile, recorder: TrackRecorder) -> None:
    frames = np.array([frame for _, frame, _ in recorder.track])
    wanted, true = set(frames.tolist()), []
    array = truth.settings.transmit.identities.index(recorder.identity)
    before = None
    for row in truth.rows():
        # a pair's pose is that of its middle: the mean of its two frames
        if before is not None and int(before["index"]) in wanted:
            true.append([(before["arrays"][array][k] + row["arrays"][array][k]) / 2 for k in ("x", "y", "distance_m")])
        before = row
    times = np.array([t for t, _, _ in recorder.track])[: len(true)]
    poses = [pose for _, _, pose in recorder.track][: len(true)]
    calibration = truth.settings.receive.calibration
    scale = calibration.focal_m * calibration.pitch_m / calibration.pixel_m
    found = {
        "x": np.array([p.x for p in poses]),
        "y": np.array([p.y for p in poses]),
        "distance_m": np.array([scale / p.pitch for p in poses]),
    }
    right = dict(zip(("x", "y", "distance_m"), np.array(true).T, strict=True))
    page.heading("Tracking")
    rms = float(np.sqrt(np.mean((found["x"] - right["x"]) ** 2 + (found["y"] - right["y"]) ** 2)))
    caption = f"Position and distance from the sum of each pattern and its inverse; rms error of position {rms:.3f} px."
    page.figure(plots.track(times, found, right), caption)


def _show_cuts(page: Report, recorder: TrackRecorder) -> None:
    first, largest = recorder.cuts[0][1], 2 * recorder.cuts[0][2].full_scale
    for title, fixed in (("without tracking", True), ("with tracking", False)):
        images = [_sum_at(first if fixed else pose, up, down) for _, pose, up, down in recorder.cuts]
        names = [f"frame {index}" for index, *_ in recorder.cuts]
        page.figure(plots.image_row(images, names, largest=largest), f"Pattern plus inverse, cut out {title}.")


def _sum_at(pose: Pose, up: AnyFrame, down: AnyFrame) -> NDArray[np.float64]:
    window = round(pose.x) - CUT_PX // 2, round(pose.y) - CUT_PX // 2, CUT_PX, CUT_PX
    return cut_out(up, window) + cut_out(down, window)


def _show_errors(page: Report, reception: Reception) -> None:
    assert reception.errors is not None  # the demonstration knows the truth
    bins = reception.errors.bins()
    page.heading("Errors by distance")
    if not bins:
        page.text("No packet was received, and none was filmed whole.")
        return
    page.figure(
        plots.errors_by_distance(bins), "Counted errors, 95 % intervals; an arrow is a bound (3/n), no error met."
    )
    head = ["distance"] + [f"{layer}: {what}" for layer in LAYERS for what in ("BER", "wrong")]
    rows = [
        [f"{start:.0f}-{start + BIN_M:.0f} m"]
        + [
            cell
            for e in layers.values()
            for cell in (f"{e.decoded_bits.text()} of {e.bits}", f"{e.codeword_errors} of {e.codewords}")
        ]
        for start, layers in bins.items()
    ]
    page.table(head, rows)
    page.text(
        f"Packets that were not sent: {reception.errors.false_packets}. "
        f"Codewords taken for right that were not sent: {reception.errors.false_codewords}.",
        note=True,
    )


SIZES = ((48, 32), (96, 64), (288, 192))
"""Widths and heights in px of the picture that the low layer sends: 29 codewords, 2.9 s, all together."""

PICTURE_QUALITY, PICTURE_SEED = 32, 11
"""Of the picture as WebP, 0 to 100; and of its drawing. Chosen by eye."""

Bar = Callable[[str, int | None], AbstractContextManager[Callable[[int], None]]]
"""Makes a progress bar of a title and a number of frames; it is called with the frames done."""


def demo_messages(settings: LinkSettings) -> list[Messages]:
    """What the light shows and a warning, the map and a description, a picture that grows: by priority."""
    road = _road(settings)
    warning = "Signal ahead: red for 12 s. Prepare to stop."
    details = (
        "Junction 7, northbound. Right lane closed for works until 18:00. Pedestrians on the east crossing. "
        "Green at 50 km/h in 12 s, at 30 km/h in 19 s. Tram 4 crosses from the left in 41 s. "
    )
    high, middle = [warning.encode()], [(details * 3).encode()]
    content: Messages = {"high": [*high, *road[:1]], "middle": [*middle, *road[1:]], "low": pictures()}
    return [content for _ in settings.transmit.identities]


def _road(settings: LinkSettings) -> list[Content]:
    """What the lights show, a message a second, and the map; nothing where their package is not installed."""
    if not is_there():
        return []
    junction = from_mapping(Junction, example())
    return [Updates(updates(junction, sent_s(settings))), mapem(junction)]


def pictures() -> list[bytes]:
    """A camera's picture of the junction as WebP: small, larger and large, so that the first is soon there."""
    scene = draw_street((SIZES[-1][1], SIZES[-1][0]), np.random.default_rng(PICTURE_SEED))
    sent = []
    for size in SIZES:
        scaled = cv2.resize(scene, size, interpolation=cv2.INTER_AREA)
        sent.append(cv2.imencode(".webp", scaled, [cv2.IMWRITE_WEBP_QUALITY, PICTURE_QUALITY])[1].tobytes())
    return sent


def film_bytes(settings: LinkSettings) -> int:
    """About how large the film of the demonstration becomes, in bytes."""
    camera = settings.channel.camera
    # bytes of a pixel in the film: 0.0097 over the whole drive before the drawn street
    return round(frames_of(settings) * camera.width * camera.height * 0.01)


@dataclass(frozen=True)
class Demonstration:
    """Result of the demonstration."""

    # All counts as plain values, see `Reception.report`
    counts: dict[str, Any]
    # The error or interruption that broke the reception off; None: it came to its end. The page shows the results so
    # far
    ending: BaseException | None = None


def run(folder: Path, settings: LinkSettings, seed: int, recordings: Recordings, bar: Bar) -> Demonstration:
    """Simulate, receive and report."""
    film = folder / "drive.mp4"
    with bar("simulating", frames_of(settings)) as advance:
        # Quality of the film as H.264. Before the drawn street the paper's drive takes 34 MB, and 66 high, 118 middle
        # and 45 low codewords are read; 338 MB at 12, with as many high, one middle and two low ones more
        count = write_film(film, settings, demo_messages(settings), seed, recordings, advance, crf=18)
    truth = open_truth(truth_path(film))
    filmed = Filmed()
    # moments at which the array is cut out for the report
    recorder = TrackRecorder([int(k) for k in np.linspace(0.02, 0.98, 8) * count])
    reception = Reception(truth)
    messages: list[Message] = []
    began = time.perf_counter()
    ending: BaseException | None = None
    try:
        with bar("receiving", count) as advance, open_film(film) as source:
            observe = _both(recorder, filmed)
            for packet, whole in receive_film(source, settings.signal, settings, reception, observe, advance):
                messages += whole
                filmed.packet(packet, whole)
    except (HeliographError, KeyboardInterrupt) as error:
        ending = error
    counts = reception.report(time.perf_counter() - began)
    for message in messages:
        write_whole(folder / message_name(message), message.data)
    moving = animated(filmed.moments)
    if moving:
        write_whole(folder / "drive.webp", moving)
    write_page(folder / "report.html", truth, (recorder, moving), reception, counts, messages)
    return Demonstration(counts, ending)


def message_name(message: Message) -> str:
    """File name of a message, by its array, layer, stream and kind."""
    suffix = kind_of(message.data)
    if suffix is None:
        suffix = "txt" if not is_picture(message.data) else "png" if message.data.startswith(b"\x89PNG") else "webp"
    return f"array-{message.identity}-{message.layer}-{message.stream}.{suffix.lower()}"


def _both(*observers: Callable[[Event], None]) -> Callable[[Event], None]:
    def observe(event: Event) -> None:
        for one in observers:
            one(event)

    return observe
