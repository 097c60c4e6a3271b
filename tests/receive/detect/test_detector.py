"""Detector: correct identity and timing for every array, no false detections."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import drawn_film, film, frame_of, link

from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import SearchParameters
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.geometry.pose import Orientation
from heliograph.signal.header import IDENTITIES, all_header_cells
from heliograph.signal.settings import SignalSettings

Light = Callable[[int, np.random.Generator], NDArray[np.float64]]


PLAIN = SearchParameters(
    min_side_px=8.0, max_side_px=64.0, min_contrast=0.03, score=0.9, regularity=0.5, candidates=6, blur_px=0.55,
    cpu_share=100.0,
)  # fmt: skip
"""Plain receiver parameters; tracked arrays are masked only briefly, so that searches have more work."""


def detections(
    frames: Iterable[Frame], signal: SignalSettings | None = None, parameters: SearchParameters = PLAIN
) -> list[Detection]:
    """Return detections; tracked arrays are masked for 50 ms, as in the receiver."""
    detector, out = PyramidSearch(parameters, signal or SignalSettings()), list[Detection]()
    for frame in frames:
        out += detector.search(frame, [d.fit.pose for d in out if frame.time_s - d.time_s < 0.05])
    return out


def first(frames: Iterable[Frame], number: int, signal: SignalSettings | None = None) -> tuple[Detection | None, int]:
    """Return the first detection with an identity and the number of earlier false detections."""
    detector, false = PyramidSearch(PLAIN, signal or SignalSettings()), 0
    for frame in frames:
        for found in detector.search(frame):
            if found.identity == number:
                return found, false
            false += 1
    return None, false


@pytest.mark.parametrize("distance_m", [25.0, 50.0, 80.0])
@pytest.mark.slow
def test_every_identity_by_its_number(distance_m: float) -> None:
    for number in range(IDENTITIES):
        place = {"x_m": 0.0, "y_m": 0.0, "start_s": 0.003 + 0.001 * (number % 2)}
        settings = link(f"transmit.identities=[{number}]", distance_m=distance_m, arrays=[place])
        found = detections(film(settings, 11, seed=number))
        assert [d.identity for d in found] == [number]
        assert found[0].start_time_s == pytest.approx(place["start_s"])
        assert found[0].fit.pose.x == pytest.approx(79.5, abs=0.05)
        assert found[0].fit.pose.y == pytest.approx(59.5, abs=0.05)
        assert found[0].fit.pose.pitch == pytest.approx(0.035 * 0.02 / (distance_m * 12e-6), rel=0.01)


PACKET = 36
"""Patterns in a packet with 16 pairs, short to save time."""


@cache
def two_packets(distance_m: float, shaken: bool) -> tuple[Frame, ...]:
    shake = {"shake": "road", "speed_m_s": 8.0, "road_class": "C", "stop_m": 1.0} if shaken else {}
    return tuple(film(link("signal.data_pairs=16", distance_m=distance_m, **shake), 2 * PACKET + 16, seed=3))


@pytest.mark.parametrize(("distance_m", "shaken"), [(30.0, True), (80.0, False), (80.0, True)])
@pytest.mark.slow
def test_start_is_right_wherever_the_film_begins(distance_m: float, shaken: bool) -> None:
    whole, false_in_all = two_packets(distance_m, shaken), 0
    # all phases near the header, few elsewhere
    for phase in [*range(6), 25, *range(30, PACKET)]:
        # the next header begins after 36 - phase frames, or at once for phase 0
        cut = whole[phase : PACKET + 16 if phase else 24]
        # even and odd frame numbers
        frames = [replace(f, index=k + phase % 2) for k, f in enumerate(cut)]
        found, false = first(frames, 0)
        assert found is not None, phase
        assert found.start_time_s == pytest.approx(0.036 if phase else 0.0, abs=1e-6), phase
        false_in_all += false
    # two data patterns in a near array may resemble a small header
    assert false_in_all <= 2


@pytest.mark.parametrize(("pairs", "distance_m"), [(1, 30.0), (1, 60.0), (3, 30.0)])
@pytest.mark.slow
def test_other_lengths_of_the_header(pairs: int, distance_m: float) -> None:
    settings = link(f"signal.header_pairs={pairs}", "transmit.identities=[13]", distance_m=distance_m)
    period = settings.signal.packet_patterns
    whole = film(settings, 2 * period + 20)
    for begin in (0, 1, period - 13, period - 1):
        found, false = first(whole[begin : begin + period + 20], 13, settings.signal)
        assert found is not None, begin
        assert found.start_time_s == pytest.approx(1e-3 * period if begin else 0.0, abs=1e-6), begin
        assert false <= 1


def noise(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    return np.asarray(rng.random((96, 128)))


def coarse_noise(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    return np.kron(rng.random((24, 32)), np.ones((4, 4))).astype(np.float64)


def lamp(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Square and round lamps toggling every frame."""
    light = np.full((96, 128), 0.1)
    light[20:52, 20:52] += 0.7 * (index % 2)
    y, x = np.mgrid[:96, :128]
    return np.where(np.hypot(x - 95.3, y - 60.2) < 14.4, 0.1 + 0.6 * (index % 2), light)


def edge(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """An edge shaking by several pixels at a quarter of the frame rate, and a moving edge."""
    light = np.full((96, 128), 0.05)
    light[:, : 60 + round(4 * np.sin(index * np.pi / 2 + 0.3))] = 0.9
    light[(index * 2) % 90 :, 100:] = 0.8
    return light


def texture(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Texture jumping by a pixel or two."""
    blocks = np.random.default_rng(9).random((30, 40))
    scene = cv2.resize(blocks, (160, 120), interpolation=cv2.INTER_NEAREST)
    dx, dy = rng.integers(0, 3, 2)
    return np.asarray(scene[dy : dy + 96, dx : dx + 128], np.float64)


@pytest.mark.parametrize("light", [noise, coarse_noise, lamp, edge, texture])
@pytest.mark.slow
def test_nothing_is_found_where_nothing_is(light: Light) -> None:
    rng = np.random.default_rng(4)
    assert detections(frame_of(light(k, rng), k, rng) for k in range(80)) == []


def test_followed_arrays_are_not_found_again() -> None:
    frames = film(link(), 120)
    found, _ = first(frames, 0)
    assert found is not None
    detector = PyramidSearch(PLAIN, SignalSettings())
    assert [d for f in frames for d in detector.search(f, [found.fit.pose])] == []


def test_a_dark_array_is_found_only_with_a_lower_contrast() -> None:
    frames = film(link(emitter={"all_on": 0.02, "panel_level": 0.0}, background={"level": 0.0}, distance_m=30.0), 12)
    assert detections(frames) == []
    assert [d.identity for d in detections(frames, parameters=replace(PLAIN, min_contrast=0.005))] == [0]


def test_an_array_at_the_border_is_no_error() -> None:
    for x_m in np.linspace(0.9, 1.8, 10):
        settings = link(arrays=[{"x_m": float(x_m), "y_m": -0.8}])
        assert {d.identity for d in detections(film(settings, 12))} == ({0} if x_m < 1.15 else set())


@pytest.mark.slow
def test_windows_that_move_with_every_frame() -> None:
    whole = [f for f in film(link(), 112) if f.index]
    moving = []
    for f in whole:
        x, y = 20 + (7 * f.index) % 5, 15 + (3 * f.index) % 4
        pixels = f.pixels[y : y + 80 + f.index % 3, x : x + 100 - f.index % 2]
        moving.append(replace(f, pixels=pixels, origin=(x, y)))
    whole_frames, found = detections(whole), detections(moving)
    assert [(d.identity, round(d.start_time_s, 6)) for d in found] == [(0, 0.1)]
    # the search covers only the windows' intersection, on a shifted grid; the fit converges to the same pose
    assert found[0].fit.vector == pytest.approx(whole_frames[0].fit.vector, abs=1e-3)


def test_windows_without_a_common_part_are_no_error() -> None:
    cut = [replace(f, pixels=f.pixels[:50, :60], origin=(200 * (f.index % 2), 0)) for f in film(link(), 12)]
    assert detections(cut) == []


@pytest.mark.slow
@pytest.mark.parametrize(("lost", "first"), [({2}, 0), ({100}, 0), ({1, 5}, 0), ({2, 3}, 0.1), ({0, 3}, 0.1)])
def test_a_header_may_lack_one_frame_of_four(lost: set[int], first: float) -> None:
    frames = film(link(), 212, 1, 20)
    starts = [0.0, 0.1, 0.2] if first == 0 else [0.1, 0.2]
    found = detections(f for f in frames if f.index not in lost)
    assert [d.start_time_s for d in found] == pytest.approx(starts, abs=1e-6)


@pytest.mark.slow
def test_where_many_frames_are_lost_headers_alone_are_found() -> None:
    frames, rng = film(link("signal.data_pairs=10"), 1200, 1, 12), np.random.default_rng(8)
    found = detections(frame for frame in frames if rng.random() > 0.4)
    assert len(found) > 15
    assert {d.identity for d in found} == {0}
    packets = np.array([d.start_time_s for d in found]) / 0.024
    assert packets == pytest.approx(np.round(packets), abs=1e-6)


def test_squares_that_blink_as_a_whole_are_found_where_headers_are_such() -> None:
    rng, parameters = np.random.default_rng(0), replace(PLAIN, all_on=True)
    frames = []
    for k in range(24):
        light = np.full((96, 128), 0.1)
        light[30:52, 40:62] += 0.6 * (8 <= k < 12 and k % 2 == 0)
        frames.append(frame_of(np.asarray(cv2.GaussianBlur(light, (0, 0), 0.7), np.float64), k, rng))
    found = detections(frames, parameters=parameters)
    assert [round(d.start_time_s, 6) for d in found] == [0.008]
    assert found[0].fit.pose.x == pytest.approx(50.5, abs=0.1)
    assert found[0].fit.pose.y == pytest.approx(40.5, abs=0.1)
    assert found[0].fit.pose.pitch == pytest.approx(22 / 16, rel=0.02)


def test_the_pose_is_that_of_its_time() -> None:
    """The pose refers to mid-exposure."""

    def even(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([40.3 + 300 * t, 48.8 - 200 * t], -1)

    (found,) = detections(drawn_film(link(), 12, even))
    assert found.start_time_s == 0
    x, y = even(np.array([found.time_s + 0.5e-3]))[0]
    assert (found.fit.pose.x, found.fit.pose.y) == pytest.approx((x, y), abs=0.15)


@pytest.mark.parametrize("mode", ["paired", "single"])
def test_cells_dimmed_by_a_format_change_neither_gain_nor_tilt(mode: str) -> None:
    """The first header pair has full contrast for every format."""
    impaired = replace(PLAIN, impaired=True, regularity=0.15)
    plain, dimmed = (
        detections(film(link(*formats, distance_m=60.0), 12), parameters=impaired)[0].fit
        for formats in ((), (f"transmit.formats=[{{mode='{mode}', high='9/10', middle='3/4', low='1/2'}}]",))
    )
    assert dimmed.gain == pytest.approx(plain.gain, rel=0.02)
    assert dimmed.pose.pitch == pytest.approx(plain.pose.pitch, rel=0.003)
    assert (dimmed.pose.stretch, dimmed.pose.shear) == pytest.approx((0, 0), abs=0.01)


@pytest.mark.parametrize("data_pairs", [18, 19])
@pytest.mark.parametrize("start", [8, 9, 14, 15])
def test_a_turned_array_is_found_wherever_its_packets_begin(start: int, data_pairs: int) -> None:
    """Packets last an odd or even number of searches; the detector tries rotated headers in every other search."""
    signal = SignalSettings(data_pairs=data_pairs)
    patterns = signal.packet_patterns
    header, rng = np.kron(all_header_cells()[4] > 0, np.ones((8, 8))), np.random.default_rng(3)
    detector, found, shown = PyramidSearch(PLAIN, signal), list[Detection](), np.full((32, 32), 0.5)
    for k in range(start + 2 * patterns):
        if (k - start) % 2 == 0:
            data = np.kron(rng.integers(0, 5, (16, 16)) / 4, np.ones((2, 2)))
            shown = header if (k - start) % patterns < 4 else data
        else:
            shown = 1 - shown
        pixels = rng.integers(38, 43, (96, 96)).astype(np.uint8)
        pixels[30:62, 34:66] += (100 * shown[::-1, ::-1]).astype(np.uint8)
        found += detector.search(Frame(k, k * 1e-3, cv2.GaussianBlur(pixels, (0, 0), 0.7).astype(np.uint8)))
    whole = [one for one in found if one.is_clear and abs(one.fit.pose.pitch - 2) < 0.1]
    assert {(one.identity, one.orientation) for one in whole} == {(4, Orientation(2))}
    assert {round(1e3 * one.start_time_s) % patterns for one in whole} == {start}
