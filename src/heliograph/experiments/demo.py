"""Demonstration: the drive of the paper simulated, received, and reported as a page."""

import io
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.base.config import from_mapping
from heliograph.base.files import write_whole
from heliograph.base.frames import Frame
from heliograph.channel.background import draw_street
from heliograph.experiments import plots
from heliograph.experiments.report import Report
from heliograph.link.film import frames_of, sent_s, write_film
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings
from heliograph.link.truth import TruthFile, open_truth, truth_path
from heliograph.measure.errors import BIN_M
from heliograph.measure.journal import message_row
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.media import open_film
from heliograph.receive.api import choose_receiver
from heliograph.receive.events import DetectEvent, Event, ExtractEvent, TrackEvent
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame, cut_out
from heliograph.receive.packet import Packet
from heliograph.receive.settings import PlainSettings
from heliograph.road.codec import Values, is_there, kind_of, mapem, road_values, road_words, updates
from heliograph.road.countdown import Countdown
from heliograph.road.junction import Junction, example
from heliograph.signal.message import Message, Updates
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import LAYER_COLOURS
from heliograph.transmit import Content, Messages

Rgb = NDArray[np.uint8]
Colour = tuple[int, int, int]

PALE: Colour = (201, 206, 214)
DIM: Colour = (110, 118, 128)
ORANGE: Colour = (255, 140, 60)

LIGHTS: Mapping[str, Colour] = {
    "red": (220, 60, 48), "red-yellow": (230, 135, 40), "yellow": (235, 185, 50), "flashing": (235, 185, 50),
    "green": (55, 170, 85), "green-free": (55, 170, 85),
}  # fmt: skip
"""Colour of each signal phase."""

VIEW_PX = 200  # height of the street, of the array and of the picture in the animation
RECENT = 5  # packets over which the bars of the animation count codewords


@dataclass(slots=True)
class DriveRecorder:
    """Observer that records the array detected first."""

    # Numbers of the frames at which pairs are kept
    cut_frames: list[int]
    # Identity of the array
    identity: int | None = None
    # Time in s, number of the first frame and pose of each pair
    track: list[tuple[float, int, Pose]] = field(default_factory=list)
    # Number of the first frame, pose and frames of each kept pair
    cuts: list[tuple[int, Pose, Frame, Frame]] = field(default_factory=list)
    # Image of the state after each packet
    images: list[Rgb] = field(default_factory=list)
    _seen: tuple[Pose, Frame] | None = None
    # Read and sent codewords of the last packets, by layer
    _words: deque[dict[str, tuple[int, int]]] = field(default_factory=lambda: deque(maxlen=RECENT))
    _picture: bytes | None = None
    _lights: Countdown = field(default_factory=Countdown)

    def __call__(self, event: Event) -> None:
        """Record an event."""
        if isinstance(event, DetectEvent) and self.identity is None:
            self.identity = event.detection.identity
        elif isinstance(event, TrackEvent) and event.identity == self.identity:
            state = event.tracked.state
            self.track.append((state.time_s, event.frame, state.pose))
        elif isinstance(event, ExtractEvent) and event.identity == self.identity:
            pattern, inverted = event.frames
            # combined frames are sections of the image
            if not isinstance(pattern, Frame) or not isinstance(inverted, Frame):
                return
            self._seen = event.poses[0], pattern
            if self.cut_frames and pattern.index >= self.cut_frames[0]:
                self.cut_frames.pop(0)
                self.cuts.append((pattern.index, event.poses[0], pattern, inverted))

    def add_packet(self, packet: Packet, messages: Sequence[Message]) -> None:
        """Record a packet of the array, and the messages completed by the packet."""
        if packet.identity != self.identity:
            return
        for message in messages:
            row = message_row(message)
            if "road" in row:
                self._lights.take(row["road"], packet.start_time_s)
            if is_picture(message.data) and len(message.data) > len(self._picture or b""):
                self._picture = message.data
        self._words.append(
            {name: (sum(w.status == "ok" for w in words), len(words)) for name, words in packet.layers.items()}
        )
        lights = [group for one in self._lights.at(packet.start_time_s) for group in one["groups"]]
        self.images.append(drawn(self._seen, self._picture, packet.distance_m, self._words, lights))
        self._seen = None


def is_picture(data: bytes) -> bool:
    """True for a PNG or WebP file."""
    return data.startswith(b"\x89PNG") or (data.startswith(b"RIFF") and data[8:12] == b"WEBP")


def pixels_of(data: bytes) -> Rgb | None:
    """Pixels of a picture file, (height, width, 3) uint8 red, green, blue; None for a damaged file."""
    pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    return None if pixels is None else np.asarray(pixels[..., ::-1], np.uint8)


def drawn(
    seen: tuple[Pose, Frame] | None,
    picture: bytes | None,
    distance_m: float,
    words: Iterable[Mapping[str, tuple[int, int]]],
    lights: Sequence[Mapping[str, Any]],
) -> Rgb:
    """Image of the state after a packet, (304, 960, 3) uint8 red, green, blue.

    Frame and pose of the array, file of the best received picture, read and sent codewords of the last packets by
    layer, signal groups.
    """
    image = np.full((304, 960, 3), (24, 27, 32), np.uint8)
    street, array, view = (image[34 : 34 + VIEW_PX, x : x + width] for x, width in ((12, 400), (424, 200), (636, 312)))
    for x, title in ((12, "camera"), (424, "array, enlarged"), (636, "received picture")):
        _write(image, title, (x, 24), PALE)
    if seen is not None:
        _draw_frame(street, array, *seen)
    pixels = pixels_of(picture) if picture else None
    if pixels is None:
        view[:] = (44, 48, 56)
        _write(image, "comes with the low layer", (696, 138), DIM)
    else:
        view[:] = cv2.resize(pixels, view.shape[1::-1], interpolation=cv2.INTER_NEAREST)
    _write(image, f"{distance_m:.0f} m", (12, 282), PALE, 0.9)
    for k, (name, colour) in enumerate(LAYER_COLOURS.items()):
        read, sent = (sum(word[name][n] for word in words if name in word) for n in (0, 1))
        y, (red, green, blue) = 247 + 19 * k, bytes.fromhex(colour[1:])
        cv2.rectangle(image, (490, y), (623, y + 11), (44, 48, 56), -1)
        cv2.rectangle(image, (490, y), (490 + round(133 * read / max(sent, 1)), y + 11), (red, green, blue), -1)
        _write(image, name, (424, y + 10), PALE)
    for k, group in enumerate(lights[:2]):
        x = 636 + 160 * k
        cv2.circle(image, (x + 12, 272), 10, LIGHTS.get(group["phase"], DIM), -1, cv2.LINE_AA)
        left_s = "" if group["left_s"] is None else f"{max(group['left_s'], 0):.0f} s"
        _write(image, f"{group['phase']} {left_s}", (x + 30, 277), PALE, 0.55)
    return image


def cut_out_of(pose: Pose, frame: Frame) -> NDArray[np.uint8]:
    """Array and surroundings, 22 pitches wide, scaled to a fixed size with no interpolation."""
    scale = VIEW_PX / (22.0 * pose.pitch)
    x, y = pose.x - frame.origin[0], pose.y - frame.origin[1]
    place = np.array([[scale, 0, VIEW_PX / 2 - scale * x], [0, scale, VIEW_PX / 2 - scale * y]])
    return np.asarray(cv2.warpAffine(_gray(frame), place, (VIEW_PX, VIEW_PX), flags=cv2.INTER_NEAREST), np.uint8)


def _gray(frame: Frame) -> NDArray[np.uint8]:
    return (frame.pixels.astype(np.float32) * (255 / frame.full_scale)).astype(np.uint8)


def _draw_frame(street: Rgb, array: Rgb, pose: Pose, frame: Frame) -> None:
    """Draw a frame with a box around the array, and the array with its surroundings, 22 pitches wide."""
    pixels = _gray(frame)
    x, y, half = pose.x - frame.origin[0], pose.y - frame.origin[1], 11.0 * pose.pitch
    scale = min(street.shape[1] / pixels.shape[1], street.shape[0] / pixels.shape[0])
    small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    street[: len(small), : small.shape[1]] = small[..., None]
    left, top, right, low = (round(scale * at) for at in (x - half, y - half, x + half, y + half))
    cv2.rectangle(street, (left, top), (right, low), ORANGE, 1, cv2.LINE_AA)
    array[:] = cut_out_of(pose, frame)[..., None]
    cv2.rectangle(array, (0, 0), (VIEW_PX - 1, VIEW_PX - 1), ORANGE, 1)


def animated(images: Sequence[Rgb]) -> bytes:
    """Animated WebP of images in an endless loop; empty for no images."""
    if not images:
        return b""
    out, rate_hz = io.BytesIO(), 10
    with av.open(out, "w", format="webp", options={"loop": "0"}) as container:
        stream = container.add_stream("libwebp_anim", rate=rate_hz)
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt, stream.options = "yuv420p", {"quality": "60"}
        # the last image stays for a second
        for image in (*images, *[images[-1]] * rate_hz):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))
    return out.getvalue()


def _write(image: Rgb, text: str, place: tuple[int, int], colour: Colour, size: float = 0.45) -> None:
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, colour, 1, cv2.LINE_AA)


def junction_plot(junction: Values, groups: Mapping[int, Mapping[str, Any]]) -> Figure:
    """Map of a junction with the phases of its signal groups."""
    figure = Figure(figsize=(7.5, 6.2))
    axes = figure.add_subplot(aspect="equal", xlabel="east (m)", ylabel="north (m)")
    # line width per metre of lane at this size of the figure
    width = 3.2 * (junction["lane_width_m"] or 3.0)
    for lane in junction["lanes"]:
        if not lane["points_m"]:
            continue
        x, y = zip(*lane["points_m"], strict=True)
        if lane["kind"] == "crosswalk":
            axes.plot(x, y, lw=width, color="#9aa1a8", ls=(0, (0.5, 0.5)), zorder=2)
        else:
            axes.plot(x, y, lw=width, color="#d9dde2", solid_capstyle="butt", zorder=1)
        group = next((groups[number] for number in lane["groups"] if number in groups), None)
        if group is None:
            continue
        colour = np.divide(LIGHTS.get(group["phase"], DIM), 255)
        axes.plot(x, y, color=colour, lw=2.2, zorder=3)
        axes.plot(x[0], y[0], "o", color=colour, ms=13, zorder=4)
        left = "" if group["left_s"] is None else f" {max(group['left_s'], 0.0):.0f} s"
        vertical = abs(y[0]) > abs(x[0])
        offset, align = ((24, 0), "left") if vertical else ((0, 24), "center")
        middle = (x[0] + x[-1]) / 2, (y[0] + y[-1]) / 2
        text = f"{group['phase']}{left}"
        axes.annotate(text, middle, offset, textcoords="offset points", ha=align, va="center")
    # "$" would start a formula
    axes.set_title(str(junction["name"] or f"junction {junction['id']}").replace("$", r"\$"))
    return figure


@plots.styled
def write_page(
    path: Path,
    truth: TruthFile,
    recorder: DriveRecorder,
    moving: bytes,
    receptions: Mapping[str, ReceptionCounter],
    counts: Mapping[str, Any],
    messages: Sequence[Message],
) -> None:
    """Write the page; `moving` is the animation, and the first receiver has recorded and received the messages."""
    receiver, reception = next(iter(receptions.items()))
    page = Report("Heliograph: a drive past an LED array")
    channel, side, cuts = truth.settings.channel, truth.settings.signal.side, recorder.cuts
    page.text(
        f"A {side} x {side} LED array sends to a {channel.camera.fps:.0f} fps camera behind the windscreen of a car "
        f"driving from {channel.distance_m:.0f} m to {channel.stop_m:.0f} m at {channel.speed_m_s * 3.6:.0f} km/h. "
        f"The film is simulated; the receiver gets only its frames. {counts['frames']} frames were read at "
        f"{counts['frames_per_second']:.0f} frames/s by the receiver {receiver}."
    )
    page.badges(_badges(counts, reception))
    if path.with_name("replay.html").exists():
        page.link("replay.html", "Replay: every moment of the reception, with a short tour")
    if moving:
        has_lights = any("road" in message_row(message) for message in messages)
        page.heading("The received drive")
        page.picture(
            moving,
            "Packet by packet: the frame, the tracked array, the picture in the low layer. Below: distance, share of "
            f"codewords read in the last {RECENT} packets by layer{', countdown of the signals' * has_lights}.",
        )
    if cuts:
        page.heading("What the camera saw")
        for name, (_, pose, frame, _) in (("far", cuts[0]), ("near", cuts[-1])):
            title = f"{name}: frame {frame.index}, {pose.pitch:.2f} px from LED to LED"
            half = 11 * pose.pitch
            figure = plots.frame_with_array(frame.pixels, pose.x, pose.y, half, title, frame.full_scale)
            page.figure(figure, f"Received image, {name}.")
    _show_messages(page, messages, reception)
    if cuts:
        _show_track(page, truth, recorder)
        names, largest = [f"frame {index}" for index, *_ in cuts], 2 * cuts[0][2].full_scale
        for title, fixed in (("without tracking", True), ("with tracking", False)):
            images = [_sum_at(cuts[0][1] if fixed else pose, up, down) for _, pose, up, down in cuts]
            page.figure(plots.image_row(images, names, largest=largest), f"Pattern plus inverse, cut out {title}.")
    if len(receptions) > 1:
        page.heading("The receivers")
        page.table(["receiver", *LAYERS], [[name, *_read_by_layer(one)] for name, one in receptions.items()])
        page.text("Codewords read: the receiver of the paper, and the receiver at the limit of the channel.", note=True)
    for name, one in receptions.items():
        _show_errors(page, name, one)
    page.write(path)


def _read_by_layer(reception: ReceptionCounter) -> list[str]:
    """Return the read codewords of each layer over all arrays, of those sent."""
    assert reception.errors is not None  # the film has its truth
    total = reception.errors.total()
    return [f"{total[name].codewords - total[name].codeword_errors} of {total[name].codewords}" for name in LAYERS]


def _badges(counts: Mapping[str, Any], reception: ReceptionCounter) -> Iterator[tuple[str, str]]:
    """Read codewords by array and layer, and false codewords, with a verdict each."""
    for array in counts["arrays"]:
        for name, layer in array["layers"].items():
            sent = layer["ok"] + layer["failed"]
            verdict = "shown" if layer["failed"] else "holds"
            yield verdict, f"array {array['id']}, {name}: {layer['ok']} of {sent} codewords read"
    if reception.errors is not None:
        false = reception.errors.false_codewords
        yield ("differs" if false else "holds"), f"accepted, but not sent: {false}"


def _show_messages(page: Report, messages: Sequence[Message], reception: ReceptionCounter) -> None:
    """Show road messages, the best version of each picture, texts, and the progress of incomplete messages."""
    page.heading("What arrived")
    # messages repeat
    unique = {(message.identity, message.layer, message.data): message for message in messages}
    rows = [(message, road_values(message.data)) for message in unique.values()]
    for identity in sorted({message.identity for message in messages}):
        _show_road(page, identity, [values for message, values in rows if values and message.identity == identity])
    pictures = [message for message in messages if is_picture(message.data)]
    best = {message.identity: message for message in sorted(pictures, key=lambda message: len(message.data))}
    for message, values in rows:
        if values is not None or (is_picture(message.data) and best[message.identity] is not message):
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
    """Show the map of the junction with its signals, and the first and last signal message."""
    lights = [one for one in values if one["kind"] == "SPATEM"]
    maps = [one for one in values if one["kind"] == "MAPEM" and one["junctions"]]
    if maps:
        groups = {g["group"]: g for one in lights[-1:] for j in one["junctions"] for g in j["groups"]}
        caption = f"Array {identity}, middle priority: the lanes of a MAPEM; signals of the last SPATEM, high priority."
        page.figure(junction_plot(maps[-1]["junctions"][0], groups), caption)
    if lights:
        page.text(f"Array {identity}, high priority, {len(lights)} SPATEMs; the first and the last:")
        page.code("\n".join(road_words(one) for one in (lights[0], lights[-1])))


def _show_track(page: Report, truth: TruthFile, recorder: DriveRecorder) -> None:
    """Show the track of the array detected first, unless the detection is false."""
    settings, names = truth.settings, ("x", "y", "distance_m")
    if recorder.identity not in settings.transmit.identities:
        return
    array = settings.transmit.identities.index(recorder.identity)
    frames = {frame for _, frame, _ in recorder.track}
    # the truth of a pair is the mean of two frames
    rows = [
        [(first["arrays"][array][k] + second["arrays"][array][k]) / 2 for k in names]
        for first, second in pairwise(truth.rows())
        if int(first["index"]) in frames
    ]
    true = dict(zip(names, np.array(rows).T, strict=True))
    track = recorder.track[: len(rows)]
    calibration = settings.receive.calibration
    scale = calibration.focal_m * calibration.pitch_m / calibration.pixel_m
    estimates = np.array([(pose.x, pose.y, scale / pose.pitch) for _, _, pose in track]).T
    found = dict(zip(names, estimates, strict=True))
    rms = float(np.sqrt(np.mean((found["x"] - true["x"]) ** 2 + (found["y"] - true["y"]) ** 2)))
    page.heading("Tracking")
    caption = f"Position and distance from the sum of each pattern and its inverse; rms error of position {rms:.3f} px."
    page.figure(plots.track(np.array([time_s for time_s, _, _ in track]), found, true), caption)


def _sum_at(pose: Pose, up: AnyFrame, down: AnyFrame) -> NDArray[np.float64]:
    """Sum of a pair in a window of 64 px."""
    window = round(pose.x) - 32, round(pose.y) - 32, 64, 64
    return cut_out(up, window) + cut_out(down, window)


def _show_errors(page: Report, receiver: str, reception: ReceptionCounter) -> None:
    assert reception.errors is not None  # the film has its truth
    bins = reception.errors.bins()
    page.heading(f"Errors by distance, receiver {receiver}")
    if not bins:
        page.text("No packet was received, and none was completely filmed.")
        return
    caption = "Counted errors, 95 % intervals; an arrow is an upper bound (3/n) with no error."
    page.figure(plots.errors_by_distance(bins), caption)
    head = ["distance"] + [f"{layer}: {cell}" for layer in LAYERS for cell in ("BER", "wrong")]
    rows = []
    for start, layers in bins.items():
        row = [f"{start:.0f}-{start + BIN_M:.0f} m"]
        for e in layers.values():
            row += [
                f"{e.decoded_bits.text()}{f' in {e.bits} bits' if e.bits else ''}",
                f"{e.codeword_errors} of {e.codewords}",
            ]
        rows.append(row)
    page.table(head, rows)
    page.text(
        f"Packets that were not sent: {reception.errors.false_packets}. "
        f"Accepted codewords that were not sent: {reception.errors.false_codewords}.",
        note=True,
    )


Bar = Callable[[str, int | None], AbstractContextManager[Callable[[int], None]]]
"""Progress bar for a title and a number of frames; call it with the completed frames."""


def demo_messages(settings: LinkSettings) -> list[Messages]:
    """Messages by priority: signals and a warning, a map and a description, a picture in three sizes."""
    warning = "Signal ahead: red for 12 s. Prepare to stop."
    details = (
        "Junction 7, northbound. Right lane closed for works until 18:00. Pedestrians on the east crossing. "
        "Green at 50 km/h in 12 s, at 30 km/h in 19 s. Tram 4 crosses from the left in 41 s. "
        "Harbour Road: two-way cycle track on the right, cyclists wait at the stop line. Next junction in 420 m: "
        "green at 45 km/h. Road wet, 6 degrees, fog at the bridge. Tunnel after 1.2 km: 4.1 m of clearance. "
        "Car park Station: 112 spaces, car park Market: full. Ferry to the island: 14:20, then every 30 minutes. "
        "Charging: 3 of 8 points free."
    )
    high: list[Content] = [warning.encode()]
    middle: list[Content] = [details.encode()]
    if is_there():
        junction = from_mapping(Junction, example())
        high.append(Updates(updates(junction, sent_s(settings))))
        middle.append(mapem(junction))
    content: Messages = {"high": high, "middle": middle, "low": pictures()}
    return [content for _ in settings.transmit.identities]


def pictures() -> list[bytes]:
    """Picture of the junction as WebP in three sizes, 29 codewords in total; the small one arrives early."""
    sizes = ((48, 32), (96, 64), (288, 192))
    scene = draw_street(sizes[-1][::-1], np.random.default_rng(11))
    scaled = (cv2.resize(scene, size, interpolation=cv2.INTER_AREA) for size in sizes)
    return [cv2.imencode(".webp", image, [cv2.IMWRITE_WEBP_QUALITY, 32])[1].tobytes() for image in scaled]


def film_bytes(settings: LinkSettings) -> int:
    """Approximate size of the film in bytes."""
    camera = settings.channel.camera
    # 0.01 bytes per pixel, measured on the drive of the paper
    return round(frames_of(settings) * camera.width * camera.height * 0.01)


def run(
    folder: Path,
    settings: LinkSettings,
    seed: int,
    recordings: Recordings,
    bar: Bar,
    show: Callable[[dict[str, Any]], object],
    receive: Callable[..., Iterator[tuple[Packet, list[Message]]]] = receive_and_count,
) -> None:
    """Simulate, receive and report; show the counts of `ReceptionCounter.report`, also before an error is raised.

    `receive` receives the film with the last receiver, as `receive_and_count`.
    """
    film = folder / "drive.mp4"
    with bar("simulating", frames_of(settings)) as advance:
        # 34 MB for the drive of the paper; crf 12 needs 338 MB for as many high and three more other codewords
        count = write_film(film, settings, demo_messages(settings), seed, recordings, advance, crf=18)
    truth = open_truth(truth_path(film))
    recorder = DriveRecorder([int(k) for k in np.linspace(0.02, 0.98, 8) * count])
    reception = ReceptionCounter(truth)
    messages: list[Message] = []
    receiver, (best, _) = settings.receive.receiver, choose_receiver(settings.signal, settings.channel.camera.fps)
    is_compared = receiver == "plain" and best == "soft"
    first = receive_and_count if is_compared else receive
    receptions, began = {receiver: reception}, time.perf_counter()
    try:
        try:
            with bar("receiving", count) as advance, open_film(film) as source:
                for packet, complete in first(source, settings.signal, settings, reception, recorder, advance):
                    messages += complete
                    recorder.add_packet(packet, complete)
        finally:
            counts = reception.report(time.perf_counter() - began)
        if is_compared:
            # the same film by the other receiver
            other = replace(settings, receive=replace(settings.receive, receiver=best, plain=PlainSettings()))
            receptions[best] = ReceptionCounter(truth)
            with bar(f"receiving by {best}", count) as advance, open_film(film) as source:
                deque(receive(source, settings.signal, other, receptions[best], progress=advance), maxlen=0)
    finally:
        for message in messages:
            write_whole(folder / message_name(message), message.data)
        moving = animated(recorder.images)
        if moving:
            write_whole(folder / "drive.webp", moving)
        write_page(folder / "report.html", truth, recorder, moving, receptions, counts, messages)
        show(counts)


def message_name(message: Message) -> str:
    """File name of a message, from array, layer, stream and kind."""
    suffix = kind_of(message.data)
    if suffix is None:
        suffix = "txt" if not is_picture(message.data) else "png" if message.data.startswith(b"\x89PNG") else "webp"
    return f"array-{message.identity}-{message.layer}-{message.stream}.{suffix.lower()}"
