"""Detectors in step and half a pattern out of step: identity and timing of every array, no false detections."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import chain, islice
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import drawn_film, film, frame_of, link, pitch_at
from search_scenes import search_parameters, shown_patterns

from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import SearchParameters
from heliograph.receive.detect.budget import TokenBucket
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.detector import Detector, HalfPeriodDetector
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.geometry.pose import Orientation
from heliograph.signal.header import IDENTITIES
from heliograph.signal.settings import SignalSettings

PLAIN = search_parameters(regularity=0.5, cpu_share=100.0)
SHORT, PACKET = "signal.data_pairs=8", 20  # short packets and the number of patterns


def detections(
    frames: Iterable[Frame], signal: SignalSettings | None = None, parameters: SearchParameters = PLAIN
) -> list[Detection]:
    """Return detections; tracked arrays are masked for 50 ms, so that searches have more work."""
    detector, out = PyramidSearch(parameters, signal or SignalSettings()), list[Detection]()
    for frame in frames:
        out += detector.search(frame, [d.fit.pose for d in out if frame.time_s - d.time_s < 0.05])
    return out


@pytest.mark.slow
def test_every_identity_is_found() -> None:
    for identity in range(IDENTITIES):
        distance_m, start_s = (25.0, 50.0, 80.0)[identity % 3], 0.003 + 0.001 * (identity % 2)
        place, camera = {"x_m": 0.0, "y_m": 0.0, "start_s": start_s}, {"width": 96, "height": 96}
        settings = link(f"transmit.identities=[{identity}]", distance_m=distance_m, arrays=[place], camera=camera)
        (found,) = detections(film(settings, 11, seed=identity))
        assert found.identity == identity
        assert found.start_time_s == pytest.approx(start_s)
        assert (found.fit.pose.x, found.fit.pose.y) == pytest.approx((47.5, 47.5), abs=0.05)
        assert found.fit.pose.pitch == pytest.approx(pitch_at(distance_m), rel=0.01)


ROAD = {"shake": "road", "speed_m_s": 8.0, "road_class": "C", "stop_m": 1.0}


@pytest.mark.parametrize(("header_pairs", "distance_m", "channel"), [
    (2, 30.0, ROAD), (2, 80.0, ROAD), (1, 30.0, {}), (1, 60.0, {}), (3, 30.0, {}),
])  # fmt: skip
@pytest.mark.slow
def test_the_start_is_right_for_any_first_frame(header_pairs: int, distance_m: float, channel: dict[str, Any]) -> None:
    changes = f"signal.header_pairs={header_pairs}", SHORT, "transmit.identities=[13]"
    settings, false_in_all = link(*changes, distance_m=distance_m, **channel), 0
    period = settings.signal.packet_patterns
    whole = film(settings, period + 16, seed=3)
    # most phases near the header, few elsewhere
    for phase in (*range(5), 10, *range(17, period)) if channel else (0, 1, period - 13, period - 1):
        # the next header begins after period - phase frames, or at once for phase 0; even and odd frame numbers
        frames = [replace(f, index=k + phase % 2) for k, f in enumerate(whole[phase:])]
        found = chain.from_iterable(map(PyramidSearch(PLAIN, settings.signal).search, frames))
        count, right = next((k, one) for k, one in enumerate(found) if one.identity == 13)
        false_in_all += count
        assert right.start_time_s == pytest.approx(1e-3 * period if phase else 0.0, abs=1e-6), phase
    # two data patterns in a near array may resemble a small header
    assert false_in_all <= 2


Light = Callable[[int, np.random.Generator], NDArray[np.float64]]


def noise(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Noise of each pixel, then of squares of 4 px."""
    return np.asarray(rng.random((96, 128)) if index < 15 else np.kron(rng.random((24, 32)), np.ones((4, 4))))


def lamp(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Square and round lamps toggling every frame."""
    light, (y, x) = np.full((96, 128), 0.1), np.mgrid[:96, :128]
    light[20:52, 20:52] += 0.7 * (index % 2)
    return np.where(np.hypot(x - 95.3, y - 60.2) < 14.4, 0.1 + 0.6 * (index % 2), light)


def edge(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """An edge shaking by several pixels at a quarter of the frame rate, and a moving edge."""
    light = np.full((96, 128), 0.05)
    light[:, : 60 + round(4 * np.sin(index * np.pi / 2 + 0.3))] = 0.9
    light[(index * 2) % 90 :, 100:] = 0.8
    return light


def texture(index: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Texture jumping by a pixel or two."""
    scene, (dx, dy) = np.kron(np.random.default_rng(9).random((30, 40)), np.ones((4, 4))), rng.integers(0, 3, 2)
    return np.asarray(scene[dy : dy + 96, dx : dx + 128], np.float64)


@pytest.mark.parametrize("light", [noise, lamp, edge, texture])
@pytest.mark.slow
def test_clutter_holds_no_array(light: Light) -> None:
    rng = np.random.default_rng(4)
    assert detections(frame_of(light(k, rng), k, rng) for k in range(30)) == []


def test_a_dark_array_is_found_with_a_lower_contrast_only() -> None:
    frames = film(link(emitter={"all_on": 0.02, "panel_level": 0.0}, background={"level": 0.0}, distance_m=30.0), 12)
    assert detections(frames) == []
    assert [d.identity for d in detections(frames, parameters=replace(PLAIN, min_contrast=0.005))] == [0]


def test_an_array_at_the_border_is_no_error() -> None:
    for x_m in np.linspace(0.9, 1.8, 10):
        settings = link(arrays=[{"x_m": float(x_m), "y_m": -0.8}])
        assert {d.identity for d in detections(film(settings, 12))} == ({0} if x_m < 1.15 else set())


@pytest.mark.slow
def test_a_window_may_move_with_every_frame() -> None:
    whole, moving, signal = film(link(SHORT), PACKET + 12)[1:], list[Frame](), SignalSettings(data_pairs=8)
    for f in whole:
        x, y = 20 + (7 * f.index) % 5, 15 + (3 * f.index) % 4
        pixels = f.pixels[y : y + 80 + f.index % 3, x : x + 100 - f.index % 2]
        moving.append(replace(f, pixels=pixels, origin=(x, y)))
    (expected,), (found,) = detections(whole, signal), detections(moving, signal)
    assert (found.identity, round(found.start_time_s, 6)) == (0, 1e-3 * PACKET)
    # the search covers only the windows' intersection, on a shifted grid; the fit converges to the same pose
    assert found.fit.vector == pytest.approx(expected.fit.vector, abs=1e-3)


def test_windows_without_a_common_part_are_no_error() -> None:
    cut = [replace(f, pixels=f.pixels[:50, :60], origin=(200 * (f.index % 2), 0)) for f in film(link(), 12)]
    assert detections(cut) == []


@pytest.mark.slow
@pytest.mark.parametrize(("lost", "first"), [({2}, 0), ({64}, 0), ({1, 5}, 0), ({2, 3}, 1), ({0, 3}, 1)])
def test_a_header_may_lack_one_frame_of_four(lost: set[int], first: int) -> None:
    settings = link("signal.data_pairs=30")
    found = detections((f for f in film(settings, 76, 1, 20) if f.index not in lost), settings.signal)
    assert [d.start_time_s for d in found] == pytest.approx([0.0, 0.064][first:], abs=1e-6)


@pytest.mark.slow
def test_only_headers_are_found_when_many_frames_are_lost() -> None:
    frames, rng = film(link("signal.data_pairs=10"), 480, 1, 12), np.random.default_rng(8)
    found = detections(frame for frame in frames if rng.random() > 0.4)
    assert [d.identity for d in found] == [0] * max(len(found), 7)
    packets = np.array([d.start_time_s for d in found]) / 0.024
    assert packets == pytest.approx(np.round(packets), abs=1e-6)


def test_blinking_squares_are_found_as_headers_without_identity() -> None:
    rng, frames = np.random.default_rng(0), []
    for k in range(24):
        light = np.full((96, 128), 0.1)
        light[30:52, 40:62] += 0.6 * (8 <= k < 12 and k % 2 == 0)
        frames.append(frame_of(np.asarray(cv2.GaussianBlur(light, (0, 0), 0.7), np.float64), k, rng))
    (found,) = detections(frames, parameters=replace(PLAIN, all_on=True))
    assert found.start_time_s == pytest.approx(0.008)
    assert (found.fit.pose.x, found.fit.pose.y) == pytest.approx((50.5, 40.5), abs=0.1)
    assert found.fit.pose.pitch == pytest.approx(22 / 16, rel=0.02)


def test_the_pose_refers_to_the_middle_of_the_exposure() -> None:
    def even(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([40.3 + 300 * t, 48.8 - 200 * t], -1)

    (found,) = detections(drawn_film(link(), 12, even))
    assert found.start_time_s == 0
    assert found.fit.vector[:2] == pytest.approx(even(np.array(found.time_s + 0.5e-3)), abs=0.15)


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


@pytest.mark.slow
@pytest.mark.parametrize("data_pairs", [8, 9])
@pytest.mark.parametrize("start", [4, 5, 6, 7])
def test_a_turned_array_is_found_wherever_its_packets_begin(start: int, data_pairs: int) -> None:
    """Packets last an even or odd number of searches; the detector tries turned headers in every other search."""
    signal, rng, found = SignalSettings(data_pairs=data_pairs), np.random.default_rng(3), list[Detection]()
    parameters = replace(PLAIN, min_side_px=16.0, max_side_px=40.0, rolls_deg=())
    patterns, detector = signal.packet_patterns, PyramidSearch(parameters, signal)
    shown_from_8_on = shown_patterns(lambda k: (k - 8) % patterns < 4, rng)
    for k, shown in enumerate(islice(shown_from_8_on, 8 - start, 8 + 2 * patterns)):
        pixels = rng.integers(38, 43, (64, 64)).astype(np.uint8)
        pixels[14:46, 18:50] += (100 * shown[::-1, ::-1]).astype(np.uint8)
        found += detector.search(Frame(k, k * 1e-3, cv2.GaussianBlur(pixels, (0, 0), 0.7).astype(np.uint8)))
    clear = [one for one in found if one.is_clear and abs(one.fit.pose.pitch - 2) < 0.1]
    seen = {(one.identity, one.orientation, round(1e3 * one.start_time_s) % patterns) for one in clear}
    assert seen == {(4, Orientation(2), start)}


def shifted_film(phase: float, distance_m: float, identity: int = 5, count: int = 12, before: int = 3) -> list[Frame]:
    """Return frames with the end of a packet, then a header after `before` + `phase` patterns."""
    place = {"x_m": 0.0, "y_m": 0.0, "start_s": (before + phase - 36) * 1e-3}
    changes = f"transmit.identities=[{identity}]", "signal.data_pairs=16"
    return film(link(*changes, distance_m=distance_m, arrays=[place]), count)


def out_of_step_detections(
    frames: Iterable[Frame], budget: TokenBucket | None = None, min_novelty: float = 1.3
) -> list[Detection]:
    detector = Detector(search_parameters(min_side_px=4.0), SignalSettings(), budget or TokenBucket(1e6, 1e-3))
    half_period = HalfPeriodDetector(detector, min_novelty)
    return [detection for frame in frames for detection in half_period.search(frame)]


def scarce_budget() -> TokenBucket:
    """Return a budget at 90 % of capacity, for which the search skips blocks without novelty."""
    budget = TokenBucket(1.0, 1e-3)
    budget.charge(0.1 * budget.capacity)
    return budget


PHASES = pytest.mark.parametrize("phase", [0.46, 0.5, 0.54])


@PHASES
@pytest.mark.parametrize(("distance_m", "identity"), [(30.0, 0), (50.0, 13), (90.0, 29)])
def test_a_header_is_found_half_a_pattern_out_of_step(phase: float, distance_m: float, identity: int) -> None:
    (found,) = out_of_step_detections(shifted_film(phase, distance_m, identity))
    assert found.identity == identity
    assert found.start_time_s == pytest.approx((3 + phase) * 1e-3, abs=1e-4)
    assert found.fit.pose.pitch == pytest.approx(58.3 / distance_m, rel=0.05)
    # gain of the array with all LEDs on; reference link: 0.8 full scale
    assert phase != 0.5 or found.fit.gain == pytest.approx(0.8 * 255, rel=0.1)


@PHASES
@pytest.mark.parametrize(("distance_m", "identity"), [(30.0, 0), (50.0, 13), (100.0, 29)])
def test_a_scarce_budget_skips_data_and_finds_the_header(phase: float, distance_m: float, identity: int) -> None:
    """A header changes more than equally many data patterns, for either first frame."""
    frames, work = shifted_film(phase, distance_m, identity, count=44, before=32), []
    # frames before the header
    for min_novelty in (1.3, 0.0):
        budget = scarce_budget()
        out_of_step_detections(frames[:31], budget, min_novelty)
        work.append(budget.load.work - scarce_budget().load.work)
    assert work[0] < 0.7 * work[1]
    header = out_of_step_detections(frames, scarce_budget())
    due = [one for one in header if one.start_time_s == pytest.approx((32 + phase) * 1e-3, abs=1e-4)]
    assert [one.identity for one in due] == [identity]


@pytest.mark.parametrize("before", [0, 1, 2])
def test_a_scarce_budget_finds_an_initial_header(before: int) -> None:
    """Without history every block is novel."""
    frames = shifted_film(0.5, 50.0, before=before)
    assert [one.identity for one in out_of_step_detections(frames, scarce_budget())] == [5]


@pytest.mark.parametrize("phase", [0.0, 0.3, 0.5])
def test_data_and_headers_in_step_noise_and_gaps_are_no_header_out_of_step(phase: float) -> None:
    rng, frames = np.random.default_rng(2), shifted_film(phase, 50.0, count=40)
    assert out_of_step_detections(frames if phase == 0.0 else frames[9:]) == []
    assert out_of_step_detections(Frame(k, k * 1e-3, rng.integers(20, 24, (64, 64), np.uint8)) for k in range(12)) == []
    assert out_of_step_detections(replace(f, index=f.index + (k >= 5)) for k, f in enumerate(frames)) == []
