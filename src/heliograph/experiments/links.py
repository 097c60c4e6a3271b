"""Links, simulated receptions and true poses that several experiments share."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.channel.camera import film
from heliograph.channel.settings import ChannelSettings
from heliograph.channel.truth import ArrayTruth, Truth
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, simulate
from heliograph.measure.bench import lasting, placed_within_pixel, window_margin_px
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.packet import Packet, Receiver
from heliograph.transmit import Messages


def static_link(distance_m: float, rng: np.random.Generator, **changes: Any) -> LinkSettings:
    """Reference link at rest for a packet, with the array displaced by up to half a pixel."""
    settings = placed_within_pixel(load_settings("static", {"channel": {"distance_m": distance_m}, **changes}), rng)
    # a margin for rounding: the last frame must end within the film
    return lasting(settings, settings.signal.packet_s + 1e-6)


def centred_link(distance_m: float, rng: np.random.Generator, brightness: float = 1.0) -> LinkSettings:
    """Reference link at rest, with the array within half a pixel of the sensor centre."""
    # focal length of the reference camera in px, rounded: 35 mm by 12 um
    x, y = (float(rng.uniform(-0.5, 0.5)) * distance_m / 2917 for _ in range(2))
    channel: dict[str, Any] = {"distance_m": distance_m, "arrays": [{"x_m": x, "y_m": y, "brightness": brightness}]}
    return load_settings("static", {"channel": channel})


def film_at_rest(
    channel: ChannelSettings, patterns: Sequence[NDArray[np.uint8]], rng: np.random.Generator, margin_px: int = 6
) -> list[tuple[Frame, ArrayTruth]]:
    """Film successive patterns of an array at rest, rendered around the array: each frame with the truth."""
    channel = replace(channel, duration_s=1e-3 * len(patterns))
    shots = film(channel, [patterns], rng, pattern_period_s=1e-3, roi_margin_px=margin_px)
    return [(frame, truth.arrays[0]) for frame, truth in shots]


def receive_link(
    settings: LinkSettings,
    messages: Sequence[Messages],
    seed: int,
    receiver: Receiver,
    recordings: Recordings | None = None,
) -> Iterator[tuple[Truth, Iterable[Packet]]]:
    """Simulate the surroundings of the arrays: the truth of each frame, and an iterator that receives the frame."""
    for frame, truth in simulate(settings, messages, seed, recordings, window_margin_px(settings)):
        yield truth, receiver.push(frame)


def receive_packets(
    settings: LinkSettings, messages: Sequence[Messages], seed: int, receiver: Receiver, truths: dict[int, ArrayTruth]
) -> Iterator[Packet]:
    """Simulate and receive: all packets, and before each frame the truth of the first array by frame number."""
    for truth, packets in receive_link(settings, messages, seed, receiver):
        truths[truth.index] = truth.arrays[0]
        yield from packets
    yield from receiver.finish()


def true_pose(truth: ArrayTruth, settings: LinkSettings) -> Pose:
    """True pose and blur of an array that faces the camera."""
    camera, emitter = settings.channel.camera, settings.channel.emitter
    radius = 0.5 * emitter.diameter_m * camera.focal_px / truth.distance_m
    return Pose(truth.x, truth.y, truth.pitch_px, truth.roll_rad, float(np.hypot(camera.blur_px, radius / 2)))
