"""The demonstration: the paper's drive filmed, received, and shown."""

import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import HeliographError
from heliograph.base.files import write_whole
from heliograph.base.frames import Frame
from heliograph.experiments import plots
from heliograph.experiments.report import Report
from heliograph.link.film import frames_of, write_film
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, Recordings
from heliograph.link.truth import TruthFile, open_truth, truth_path
from heliograph.measure.errors import BIN_M
from heliograph.measure.reception import Reception, receive_film
from heliograph.media import open_film
from heliograph.receive import Pose
from heliograph.receive.detect import cut_out
from heliograph.signal.message import Message
from heliograph.signal.settings import LAYERS

CUT_OUTS = 8
"""Moments at which the array is cut out for the report."""

CUT_PX = 64

Bar = Callable[[str, int | None], AbstractContextManager[Callable[[int], None]]]


@dataclass(slots=True)
class _Watch:
    """Observer that keeps what the report shows of the first array."""

    moments: list[int]
    track: list[tuple[float, int, Pose]] = field(default_factory=list)
    cuts: list[tuple[int, Pose, Frame, Frame]] = field(default_factory=list)
    identity: int | None = None

    def __call__(self, stage: str, data: Mapping[str, Any], /) -> None:
        if stage == "detect" and self.identity is None:
            self.identity = data["detection"].identity
        if stage == "track" and data["identity"] == self.identity:
            state = data["tracked"].state
            self.track.append((state.time_s, data["frame"], state.pose))
        if stage == "extract" and data["identity"] == self.identity:
            self._cut(data)

    def _cut(self, data: Mapping[str, Any]) -> None:
        pattern, inverted = data["frames"]
        if self.moments and pattern.index >= self.moments[0]:
            self.moments.pop(0)
            self.cuts.append((pattern.index, data["poses"][0], pattern, inverted))


def demo_messages(settings: LinkSettings) -> list[Messages]:
    """A warning, a description and a picture, by priority."""
    warning = "Signal ahead: red for 12 s. Prepare to stop."
    details = (
        "Junction 7, northbound. Right lane closed for works until 18:00. Pedestrians on the east crossing. "
        "Green at 50 km/h in 12 s, at 30 km/h in 19 s. Tram 4 crosses from the left in 41 s. "
    )
    content = {"high": [warning.encode()], "middle": [(details * 3).encode()], "low": [_map_picture()]}
    return [content for _ in settings.transmit.identities]


@dataclass(frozen=True)
class Demonstration:
    """What came of it.

    Attributes
    ----------
    counts
        See `Reception.report`.
    ending
        What broke the reception off, if anything did; the report shows the results so far.
    """

    counts: dict[str, Any]
    ending: BaseException | None = None


def run(folder: Path, settings: LinkSettings, seed: int, recordings: Recordings, bar: Bar) -> Demonstration:
    """Simulate, receive and report.

    Parameters
    ----------
    folder
        Gets drive.mp4, its truth, the messages and report.html.
    settings, seed, recordings
        See `simulate`.
    bar
        Makes a progress bar of a title and a number of frames.

    Returns
    -------
    What came of it.
    """
    film = folder / "drive.mp4"
    with bar("simulating", frames_of(settings)) as advance:
        count = write_film(film, settings, demo_messages(settings), seed, recordings, advance, lossless=True)
    truth = open_truth(truth_path(film))
    watch = _Watch([int(k) for k in np.linspace(0.02, 0.98, CUT_OUTS) * count])
    reception = Reception(truth)
    messages: list[Message] = []
    began = time.perf_counter()
    ending: BaseException | None = None
    try:
        with bar("receiving", count) as advance, open_film(film) as source:
            for _, whole in receive_film(source, settings.signal, settings, reception, watch, advance):
                messages += whole
    except (HeliographError, KeyboardInterrupt) as error:
        ending = error
    counts = reception.report(time.perf_counter() - began)
    for message in messages:
        write_whole(folder / message_name(message), message.data)
    _write_report(folder / "report.html", settings, truth, watch, reception, counts, messages)
    return Demonstration(counts, ending)


def message_name(message: Message) -> str:
    """File name of a message, by its array, layer and kind."""
    suffix = "png" if message.data.startswith(b"\x89PNG") else "txt"
    return f"array-{message.identity}-{message.layer}-{message.stream}.{suffix}"


def _write_report(
    path: Path,
    settings: LinkSettings,
    truth: TruthFile,
    watch: _Watch,
    reception: Reception,
    counts: Mapping[str, Any],
    messages: list[Message],
) -> None:
    page = Report("Heliograph: a drive past an LED array")
    channel = settings.channel
    side = settings.signal.side
    page.text(
        f"A {side} x {side} LED array speaks to a {channel.camera.fps:.0f} fps camera behind the windscreen of a car "
        f"driving from {channel.distance_m:.0f} m to {channel.stop_m:.0f} m at {channel.speed_m_s * 3.6:.0f} km/h. "
        f"The film is simulated; the receiver gets its frames alone. {counts['frames']} frames were read at "
        f"{counts['frames_per_second']:.0f} frames/s."
    )
    _show_messages(page, messages, reception)
    if watch.cuts:
        _show_frames(page, watch)
        if watch.identity in settings.transmit.identities:
            _show_track(page, truth, watch)
        _show_cuts(page, watch)
    _show_errors(page, reception)
    page.write(path)


def _show_messages(page: Report, messages: list[Message], reception: Reception) -> None:
    page.heading("What arrived")
    for message in messages:
        page.text(f"Array {message.identity}, {message.layer} priority, {len(message.data)} bytes:")
        if message.data.startswith(b"\x89PNG"):
            page.picture(message.data, "a picture, sent with low priority")
        else:
            page.code(message.data.decode("utf-8", "replace"))
    for identity, layer, _, had, size in reception.unfinished():
        page.text(f"Array {identity}, {layer} priority: {had} of {size} bytes, not complete.", note=True)
    if not messages:
        page.text("No message is complete.")


def _show_frames(page: Report, watch: _Watch) -> None:
    page.heading("What the camera saw")
    for which, (_, pose, frame, _) in (("far", watch.cuts[0]), ("near", watch.cuts[-1])):
        title = f"{which}: frame {frame.index}, {pose.pitch:.2f} px from LED to LED"
        half = 11 * pose.pitch
        figure = plots.frame_with_array(frame.pixels, pose.x, pose.y, half, title, frame.full_scale)
        page.figure(figure, f"Received image, {which}.")


def _show_track(page: Report, truth: TruthFile, watch: _Watch) -> None:
    frames = np.array([frame for _, frame, _ in watch.track])
    wanted, true = set(frames.tolist()), []
    array = truth.settings.transmit.identities.index(watch.identity)
    before = None
    for row in truth.rows():
        # a pair's pose is that of its middle: the mean of its two frames
        if before is not None and int(before["index"]) in wanted:
            true.append([(before["arrays"][array][k] + row["arrays"][array][k]) / 2 for k in ("x", "y", "distance_m")])
        before = row
    times = np.array([t for t, _, _ in watch.track])[: len(true)]
    poses = [pose for _, _, pose in watch.track][: len(true)]
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


def _show_cuts(page: Report, watch: _Watch) -> None:
    first, largest = watch.cuts[0][1], 2 * watch.cuts[0][2].full_scale
    for title, fixed in (("without tracking", True), ("with tracking", False)):
        images = [_sum_at(first if fixed else pose, up, down) for _, pose, up, down in watch.cuts]
        names = [f"frame {index}" for index, *_ in watch.cuts]
        page.figure(plots.image_row(images, names, largest=largest), f"Pattern plus inverse, cut out {title}.")


def _sum_at(pose: Pose, up: Frame, down: Frame) -> NDArray[np.float64]:
    corner = round(pose.x) - CUT_PX // 2, round(pose.y) - CUT_PX // 2
    return cut_out(up, *corner, CUT_PX, CUT_PX) + cut_out(down, *corner, CUT_PX, CUT_PX)


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


def _map_picture() -> bytes:
    """A small map of a junction as PNG."""
    image = np.full((64, 96), 235, np.uint8)
    cv2.rectangle(image, (0, 26), (95, 40), 120, -1)
    cv2.rectangle(image, (44, 0), (58, 63), 120, -1)
    for x in range(2, 96, 8):
        cv2.line(image, (x, 33), (x + 3, 33), 250, 1)
    cv2.circle(image, (63, 21), 3, 30, -1)
    cv2.putText(image, "7", (70, 18), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 30, 1)
    return bytes(cv2.imencode(".png", image)[1])
