"""Published receivers: the qualitative result of each source, on small films."""

from functools import cache

import numpy as np
import pytest
from scenes import film, link, received, words_of

from heliograph.base.errors import HeliographError, SettingsError
from heliograph.base.frames import Frame
from heliograph.measure.bench import run_block
from heliograph.published.kaic import SAME_PATTERN, estimate_phase, slot_covariance
from heliograph.receive.api import list_receivers, make_receiver
from heliograph.receive.packet import Packet
from heliograph.receive.registry import RECEIVERS, is_bound
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

SEED = 45


@cache
def raw_errors(receiver: str, distance_m: float, modulation: str = "ook") -> dict[str, int]:
    """Count the wrong bits of each layer before the channel decoder, of a packet that all receivers get."""
    changes = f"receive.receiver={receiver}", f"signal.modulation={modulation}", "signal.data_pairs=24"
    counts = run_block(link(*changes, distance_m=distance_m), SEED, max_packets=1)
    assert counts.detected == counts.packets == 1
    assert counts.false_codewords == 0
    return {name: layer.raw_errors for name, layer in counts.layers.items()}


def total(receiver: str, distance_m: float, modulation: str = "ook") -> int:
    """Count the wrong bits among 6144."""
    return sum(raw_errors(receiver, distance_m, modulation).values())


@cache
def packet_film(modulation: str, distance_m: float) -> list[Frame]:
    return film(link(f"signal.modulation={modulation}", "signal.data_pairs=24", distance_m=distance_m), 55, SEED, 12)


def packet(receiver: str, modulation: str, distance_m: float) -> Packet:
    settings = link(f"signal.modulation={modulation}", "signal.data_pairs=24", f"receive.receiver={receiver}")
    (received_packet,) = received(packet_film(modulation, distance_m), settings)
    return received_packet


@pytest.mark.slow
@pytest.mark.parametrize("modulation", ["haar", "ook"])
def test_threshold_decides_like_plain_without_soft_values(modulation: str) -> None:
    plain, threshold = (words_of(packet(name, modulation, 45.0)) for name in ("plain", "threshold"))
    for soft, hard in zip(plain, threshold, strict=True):
        assert np.array_equal(soft.raw, hard.raw)
        assert np.unique(np.abs(hard.llr)).size == 1
        assert np.unique(np.abs(soft.llr)).size > 1
    assert {word.status for word in threshold} == {"ok"}


PUBLISHED = [name for name, place in RECEIVERS.built_in.items() if ".published." in place]


@pytest.mark.parametrize("name", [name for name in PUBLISHED if not is_bound(name)])
def test_published_receivers_are_made_by_name(name: str) -> None:
    assert name in list_receivers()
    assert list(make_receiver(SignalSettings(), ReceiveSettings(receiver=name)).finish()) == []
    with pytest.raises(SettingsError, match="has no effect"):
        ReceiveSettings(receiver=name, plain={"equaliser": "inverse"})  # type: ignore[arg-type]


@pytest.mark.slow
def test_cancellation_of_interference_reads_farther() -> None:
    """Kasashima et al. 2013: free of error to 40 m without and to 60 m with the cancellation."""
    assert total("threshold", 40.0) == total("kasashima", 40.0) == 0
    assert total("threshold", 53.0) > 60
    assert total("kasashima", 53.0) <= 3


@pytest.mark.slow
def test_zero_forcing_reads_farther_until_the_noise_prevails() -> None:
    assert total("zero-forcing", 57.0) < 0.1 * total("threshold", 57.0)
    # beyond, zero forcing amplifies the noise
    assert total("zero-forcing", 90.0) > total("threshold", 90.0)


@pytest.mark.slow
@pytest.mark.parametrize(("distance_m", "modulation"), [(65.0, "ook"), (70.0, "haar"), (90.0, "haar")])
def test_mmse_limits_the_noise(distance_m: float, modulation: str) -> None:
    mmse = total("mmse", distance_m, modulation)
    assert mmse <= total("zero-forcing", distance_m, modulation)
    assert mmse < 0.8 * total("threshold", distance_m, modulation)


@pytest.mark.slow
@pytest.mark.parametrize("receiver", ["svm", "mlp"])
@pytest.mark.parametrize(("distance_m", "modulation"), [
    (53.0, "ook"), (65.0, "ook"), (60.0, "haar"), (75.0, "haar"), (90.0, "haar"),
])  # fmt: skip
def test_learned_decisions_read_farther_than_a_threshold(receiver: str, distance_m: float, modulation: str) -> None:
    assert total(receiver, distance_m, modulation) < 0.9 * total("threshold", distance_m, modulation)


@pytest.mark.slow
@pytest.mark.parametrize("receiver", ["svm", "mlp"])
@pytest.mark.parametrize("modulation", ["haar", "ook"])
def test_learned_decisions_hold_nearer_than_the_training(receiver: str, modulation: str) -> None:
    assert total(receiver, 20.0, modulation) < 20


@pytest.mark.slow
@pytest.mark.parametrize(("modulation", "phase"), [
    ("ook", 0.1), ("ook", 0.35), ("ook", 0.6), ("ook", 0.85), ("haar", 0.1), ("haar", 0.6), ("haar", 0.85),
])  # fmt: skip
def test_oversampling_selects_the_phase_of_a_camera_out_of_step(modulation: str, phase: float) -> None:
    changes = f"signal.modulation={modulation}", "signal.data_pairs=24", "receive.receiver=oversampling"
    camera = {"width": 160, "height": 120, "fps": 2000.0, "exposure_s": 5e-4, "start_s": phase * 1e-3}
    counts = run_block(link(*changes, camera=camera, distance_m=25.0), SEED, max_packets=2)
    assert counts.packets > 0
    assert [layer.codeword_errors for layer in counts.layers.values()] == [0, 0, 0]


def test_oversampling_refuses_a_frame_per_pattern() -> None:
    settings = link("receive.receiver=oversampling")
    with pytest.raises(HeliographError, match="needs two frames per pattern: the film has 1000"):
        received(film(settings, 20, roi_margin_px=12), settings)


@pytest.mark.slow
def test_oversampling_follows_the_drift_of_a_camera() -> None:
    """A drift by a pattern passes two selections; a selection costs a packet at most."""
    camera = {"width": 160, "height": 120, "fps": 2000.0, "exposure_s": 5e-4, "start_s": 1e-4, "clock_ppm": -2000.0}
    changes = "signal.modulation=ook", "signal.data_pairs=24", "receive.receiver=oversampling"
    counts = run_block(link(*changes, camera=camera, distance_m=30.0), SEED, max_packets=12)
    assert counts.packets >= 11
    assert counts.layers["high"].codeword_errors <= 1


@pytest.mark.parametrize("per_pattern", [1.0, 1.3, 2.0])
def test_kurtosis_shows_the_mixing_ratio(per_pattern: float) -> None:
    """Random on-off LEDs with inverses and noise of 3 %; a guess would be as close in a fifth of the cases."""
    rng = np.random.default_rng([SEED, int(10 * per_pattern)])
    slots = slot_covariance(SignalSettings(modulation="ook")) * SAME_PATTERN
    for phase in rng.uniform(size=4):
        pairs = rng.integers(0, 2, (27, 60)).astype(float)
        patterns = np.stack([pairs, 1 - pairs], 1).reshape(54, 60)
        starts, exposure = np.arange(1, int(50 * per_pattern)) / per_pattern, 1 / per_pattern
        # light since the start of pattern 0, linear in each pattern
        sums, edges = np.vstack([np.zeros(60), np.cumsum(patterns, 0)]), np.arange(55) + phase
        light = [[np.interp(t, edges, led) for led in sums.T] for t in (*starts, *(starts + exposure))]
        first, last = np.split(np.array(light), 2)
        frames = (last - first) / exposure + rng.normal(0, 0.03, first.shape)
        error = estimate_phase(starts, frames, exposure, slots, np.arange(0, 1, 1 / 32)) - phase
        assert abs(error - round(error)) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("modulation", "fps", "phase"), [
    ("ook", 1000.0, 0.27), ("ook", 1000.0, 0.74), ("ook", 1300.0, 0.55), ("haar", 2000.0, 0.85),
])  # fmt: skip
def test_blind_separation_reads_a_camera_out_of_step(modulation: str, fps: float, phase: float) -> None:
    camera = {"width": 160, "height": 120, "fps": fps, "exposure_s": 1 / fps}
    array = {"x_m": 0.0, "y_m": 0.0, "start_s": phase * 1e-3}
    changes = f"signal.modulation={modulation}", "signal.data_pairs=24", "receive.receiver=kaic"
    counts = run_block(link(*changes, camera=camera, arrays=[array], distance_m=25.0), SEED, max_packets=2)
    assert counts.packets > 0
    assert [layer.codeword_errors for layer in counts.layers.values()] == [0, 0, 0]


def test_blind_separation_refuses_fewer_frames_than_patterns() -> None:
    settings = link("receive.receiver=kaic", camera={"width": 160, "height": 120, "fps": 800.0})
    with pytest.raises(HeliographError, match="kaic receiver needs at least one frame per pattern: the film has 800"):
        received(film(settings, 20, roi_margin_px=12), settings)
