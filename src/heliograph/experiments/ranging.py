"""Ranging: distance and pose of an array by the receivers, by phase-only correlation (POC), and by an ArUco marker.

All methods film the same road at 30 km/h with the same camera; the truth is the pose in the middle of a packet. POC
follows arXiv 2510.17203, for frames in place of events. Blocks of LEDs in the corners send Walsh-Hadamard pilots.
Correlating eight frames with the pilots gives an image of each block. The displacements of these images give the
distance by triangulation, in the direction of the largest displacement, the axis of a tilt. The marker is lit like the
array; its black square has the size of the array, with a bright margin. The detector needs modules of several pixels,
so the frame is enlarged four times. Both references see only the surroundings of the array.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import fft
from scipy.linalg import hadamard
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError, SettingsError
from heliograph.base.frames import Frame
from heliograph.channel.camera import film
from heliograph.channel.scene import lens_matrix
from heliograph.channel.settings import EmitterSettings
from heliograph.experiments.report import Context
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import simulate
from heliograph.measure.bench import random_messages, window_margin_px
from heliograph.measure.errors import pose_in_space
from heliograph.receive.api import make_receiver
from heliograph.receive.geometry.window import common
from heliograph.signal.pwm import SLOTS

RECEIVERS = ("plain", "soft")
PACKETS = 2  # packets of a film; the last is compared, as a detection alone gives no speed
MARKER = 7  # number of the marker
PILOTS = hadamard(8)[[1, 2, 4, 7]]  # their products have no linear trend: steady motion mixes no blocks
BLOCK = 4  # LEDs along the side of a block
MIN_PEAK = 0.5  # smallest correlation of the images of two blocks; 1 without noise

Pose = tuple[Floats, Rotation]  # centre in m, and orientation

Levels = NDArray[np.uint8]  # patterns


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Rms errors of a method at a distance; None without an estimate."""

    distance_m: float
    method: str
    found: int
    films: int
    # Relative error of the distance, with the 95 % interval by the bootstrap over films
    distance_error: float | None
    low: float | None
    high: float | None
    # Across the line of sight; yaw of the nearer of two poses
    lateral_m: float | None
    yaw_deg: float | None


def measure(distances_m: Sequence[float], seeds: Iterable[int], context: Context) -> list[Accuracy]:
    """Film an array with random direction and yaw for each distance and seed, and compare all methods."""
    if wrong := [distance_m for distance_m in distances_m if not 10 <= distance_m <= 1000]:
        raise SettingsError(f"distances are 10 to 1000 m, not {wrong[0]:g}; change --at")
    if not hasattr(getattr(cv2, "aruco", None), "ArucoDetector"):
        raise HeliographError(f"markers need OpenCV 4.7, not {cv2.__version__}: pip install -U opencv-python-headless")
    films = list(seeds)
    errors = context.each("films", compare, [(distance_m, seed) for distance_m in distances_m for seed in films])
    groups = [errors[first : first + len(films)] for first in range(0, len(errors), len(films))]
    return [
        _accuracy(distance_m, method, np.array([film[method] for film in group]))
        for distance_m, group in zip(distances_m, groups, strict=True)
        for method in group[0]
    ]


def compare(work: tuple[float, int]) -> Mapping[str, Floats]:
    """Return relative error of distance, lateral error in m and error of yaw in degrees by method, NaN if unknown."""
    link, seed = drive(*work), work[1]
    shots = list(simulate(link, random_messages(link, seed), seed, None, window_margin_px(link)))
    truth = shots[round((PACKETS - 0.5) * link.signal.packet_patterns)][1].arrays[0].homography
    found = {name: np.full(3, np.nan) for name in (*RECEIVERS, "POC", "ArUco")}
    for name in RECEIVERS:
        receiver = make_receiver(link.signal, replace(link.receive, receiver=name))
        for packet in [*(packet for frame, _ in shots for packet in receiver.push(frame)), *receiver.finish()]:
            poses = [(pose.translation_m, Rotation.from_rotvec(pose.rotation_rad)) for pose in packet.spatial_poses]
            if poses and round(packet.start_time_s / link.signal.packet_s) == PACKETS - 1:
                found[name] = _errors(link, truth, packet.distance_m, poses)
    frames, truth = shoot(link, seed, pilots(link.signal.side), link.channel.emitter)
    if distance_m := range_by_correlation(frames, link):
        found["POC"] = _errors(link, truth, distance_m, [])
    frames, truth = shoot(link, seed, *marker(link))
    if poses := marker_poses(frames[0], link):
        found["ArUco"] = _errors(link, truth, poses[0][0][2], poses)
    return found


def drive(distance_m: float, seed: int) -> LinkSettings:
    """Return a drive that has the array at a distance in the middle of the last packet."""
    link = load_settings("paper")
    length_s, speed = PACKETS * link.signal.packet_s, link.channel.speed_m_s
    start_m = distance_m + speed * (length_s - link.signal.packet_s / 2)
    x, y, yaw = np.random.default_rng([seed, 3]).uniform([-0.05, -0.02, -30], [0.05, 0.01, 30]).tolist()
    array = {"x_m": x * distance_m, "y_m": y * distance_m, "yaw_deg": yaw}
    # 1e-6 s: the last frame must end within the film
    ends = {"distance_m": start_m, "stop_m": start_m - speed * length_s, "duration_s": length_s + 1e-6}
    return load_settings("paper", {"channel": {**ends, "arrays": [array]}})


def shoot(link: LinkSettings, seed: int, patterns: Levels, emitter: EmitterSettings) -> tuple[list[Frame], Floats]:
    """Film patterns in the middle of the last packet; return the frames and the true homography."""
    channel, period_s = link.channel, link.signal.pattern_period_s
    start_s = (PACKETS - 0.5) * link.signal.packet_s - len(patterns) // 2 * period_s
    camera, place = replace(channel.camera, start_s=start_s), replace(channel.arrays[0], start_s=start_s)
    changed = replace(channel, camera=camera, arrays=(place,), emitter=emitter)
    rng, margin_px = np.random.default_rng(seed), window_margin_px(link)
    shots = film(changed, [patterns], rng, pattern_period_s=period_s, roi_margin_px=margin_px)
    frames, truths = zip(*islice(shots, len(patterns)), strict=True)
    return list(frames), truths[len(patterns) // 2].arrays[0].homography


def pilots(side: int) -> Levels:
    """Return the pilots of the blocks in the upper left, upper right, lower left and lower right corner."""
    end = np.arange(side) < BLOCK
    corners = [np.outer(rows, columns) for rows in (end, end[::-1]) for columns in (end, end[::-1])]
    return np.asarray(SLOTS * np.tensordot(PILOTS.T > 0, corners, 1), np.uint8)


def range_by_correlation(frames: Sequence[Frame], link: LinkSettings) -> float | None:
    """Return the distance in m by the displacements between the images of the blocks; None without a clear peak."""
    images = np.tensordot(PILOTS, np.stack([frame.pixels.astype(float) for frame in common(frames)]), 1)
    pairs = [displacement(images[first], images[second]) for first, second in ((0, 1), (2, 3), (0, 2), (1, 3))]
    if min(peak for _, peak in pairs) < MIN_PEAK:
        return None
    across_and_down = np.reshape([shift for shift, _ in pairs], (2, 2, 2)).mean(1)
    baseline_m = (link.signal.side - BLOCK) * link.channel.emitter.pitch_m
    # triangulation: Z = f B / d
    return float(link.channel.camera.focal_px * baseline_m / np.linalg.norm(across_and_down, 2))


def displacement(first: Floats, second: Floats, band: float = 0.15) -> tuple[Floats, float]:
    """Return the displacement (x, y) of an image in px, and the peak of the phase-only correlation, at most 1.

    The band, in cycles per px, excludes frequencies of more noise than light. The peak is found between pixels.
    """
    shape = tuple(fft.next_fast_len(2 * n) for n in first.shape)
    cross = fft.fft2(second, shape) * np.conj(fft.fft2(first, shape))
    y, x = np.meshgrid(*map(fft.fftfreq, shape), indexing="ij")
    inside = np.hypot(x, y) < band
    coarse = fft.ifft2(np.where(inside, np.exp(1j * np.angle(cross)), 0)).real
    half = np.array(shape) // 2
    row, column = (np.unravel_index(coarse.argmax(), shape) + half) % shape - half
    phases, waves = np.angle(cross[inside]), 2 * np.pi * np.stack([x[inside], y[inside]])
    fit = minimize(lambda shift: -np.cos(phases + shift @ waves).mean(), [column, row])
    return fit.x, float(-fit.fun)


def marker(link: LinkSettings) -> tuple[Levels, EmitterSettings]:
    """Return the modules of a marker with the size of the array, and the emitter that shows them."""
    modules = cv2.aruco.generateImageMarker(_dictionary(), MARKER, _dictionary().markerSize + 2) // 255 * SLOTS
    pitch_m = link.signal.side * link.channel.emitter.pitch_m / len(modules)
    emitter = replace(link.channel.emitter, shape="cell", pitch_m=pitch_m, panel_margin_m=0.0)
    return np.pad(np.asarray(modules, np.uint8), 1, constant_values=SLOTS)[None], emitter


def marker_poses(frame: Frame, link: LinkSettings, enlarged: int = 4) -> list[Pose]:
    """Return the two poses of the marker that fit the corners, the better first; none if not detected."""
    parameters = cv2.aruco.DetectorParameters()
    # the smallest errors of the four refinements (seeds 200 to 211)
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    image = cv2.resize(frame.pixels, None, fx=enlarged, fy=enlarged, interpolation=cv2.INTER_CUBIC)
    corners, numbers, _ = cv2.aruco.ArucoDetector(_dictionary(), parameters).detectMarkers(image)
    if numbers is None or MARKER not in (found := np.ravel(numbers).tolist()):
        return []
    # this refinement has the origin at the corner of the first pixel
    points = np.reshape(corners[found.index(MARKER)], (4, 2)) / enlarged - 0.5 + frame.origin
    half_m = link.signal.side * link.channel.emitter.pitch_m / 2
    square = half_m * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    lens = lens_matrix(link.channel.camera)
    _, turns, places, _ = cv2.solvePnPGeneric(square, points, lens, None, flags=cv2.SOLVEPNP_IPPE_SQUARE)
    upright = Rotation.from_rotvec([np.pi, 0, 0])  # the axes of the marker are right, up, back
    solutions = zip(np.asarray(places, float), np.asarray(turns, float), strict=True)
    return [(place.ravel(), Rotation.from_rotvec(turn.ravel()) * upright) for place, turn in solutions]


def _dictionary() -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)


def _errors(link: LinkSettings, truth: Floats, distance_m: float, poses: Sequence[Pose]) -> Floats:
    """Compare an estimate with the true homography."""
    centre, turn = pose_in_space(truth, link.channel.camera)
    right = np.array([rotation.as_matrix()[:, 0] for rotation in (turn, *(rotation for _, rotation in poses))])
    yaw, *yaws = np.degrees(np.arctan2(-right[:, 2], right[:, 0]))
    lateral_m = np.hypot(*(poses[0][0] - centre)[:2]) if poses else np.nan
    return np.array([distance_m / centre[2] - 1, lateral_m, min(np.abs(yaws - yaw), default=np.nan)])


def _accuracy(distance_m: float, method: str, errors: Floats) -> Accuracy:
    """Pool the errors of all films, (films, 3)."""
    squares = errors[~np.isnan(errors[:, 0])] ** 2
    n = len(squares)
    drawn = np.random.default_rng(0).integers(max(n, 1), size=(2000, n))
    ends = np.quantile(squares[drawn, 0].mean(1), [0.025, 0.975]) if n else [np.nan] * 2
    rms = np.sqrt(squares.mean(0)) if n else [np.nan] * 3
    values = (None if np.isnan(v) else float(v) for v in (rms[0], *np.sqrt(ends), *rms[1:]))
    return Accuracy(distance_m, method, n, len(errors), *values)
