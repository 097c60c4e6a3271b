"""The page of the demonstration: what the camera saw, what arrived, and how much of it was wrong."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.experiments import plots
from heliograph.experiments.demo.animation import is_picture, pixels_of
from heliograph.experiments.demo.junction_picture import junction_picture
from heliograph.experiments.demo.recorder import TrackRecorder
from heliograph.experiments.report import Report
from heliograph.link.truth import TruthFile
from heliograph.measure.errors import BIN_M
from heliograph.measure.reception import Reception
from heliograph.receive import Pose
from heliograph.receive.geometry.window import ImagePatch, cut_out
from heliograph.road.read import Values, road_values, road_words
from heliograph.signal.message import Message
from heliograph.signal.settings import LAYERS

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


def _sum_at(pose: Pose, up: ImagePatch, down: ImagePatch) -> NDArray[np.float64]:
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
