"""LED brightness estimated from decoded data."""

import numpy as np
import pytest
from known_packets import FORM, random_blocks, symbols_of
from numpy.typing import NDArray
from scenes import SIDE, draw, film, frame_of, link, pitch_at

from heliograph.base.threads import one_thread
from heliograph.receive import Pose, receive_frames
from heliograph.receive.equalise import led_gains
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.pose_refinement import ObservedPacket
from heliograph.receive.observe.cutout import take_cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal import haar

Floats = NDArray[np.float64]

GAIN, NOISE = 0.7 * 255, Noise(4.5, 1.5)
EQUAL = np.ones((SIDE, SIDE))


def unequal(spread: float) -> Floats:
    gains = 1 + spread * np.random.default_rng(3).standard_normal((SIDE, SIDE))
    return np.asarray(gains / np.median(gains))


def learnt(gains: Floats, known: int, before: LedGains | None = None, pulled: float = 0.0, blocks: int = 0) -> LedGains:
    """Estimate brightness from a packet at 95 m with the first `known` symbols of each pair decoded."""
    rng, symbols = np.random.default_rng([blocks, 1]), symbols_of(random_blocks(blocks))
    cutouts = []
    for x in haar.encode(FORM.join(symbols.astype(np.int8))) / 4.0:
        x_px, y_px = (float(v) for v in rng.uniform(30, 31, 2))
        pose = Pose(x_px, y_px, pitch_at(95.0), float(rng.normal(0, 0.01)), 0.51)
        up, down = (
            frame_of(0.1 + 0.7 * draw(pose, y * gains, (0, 0), (60, 60)), k, rng) for k, y in enumerate((x, 1 - x))
        )
        thought = pose.moved(pulled, -pulled)
        cutouts.append(take_cutout(FramePair(up, down), (thought, thought), SIDE))
    variance = np.broadcast_to(np.where(np.arange(symbols.shape[1]) < known, 0.0, 1.0), symbols.shape)
    with one_thread():
        observed = ObservedPacket(cutouts, NOISE, FORM, before or LedGains.sound(SIDE))
        return observed.learn_gains(np.where(variance == 0, symbols, 0.0), variance, GAIN, NOISE.lit)


def information_of(led_gains: LedGains) -> Floats:
    """Return the brightness information per LED."""
    assert led_gains.data is not None
    return np.asarray(led_gains.data[0].sum(0))


@pytest.mark.parametrize(("known", "left"), [(192, 0.16), (256, 0.08)])
def test_brightness_of_unequal_leds_is_estimated(known: int, left: float) -> None:
    """Eight pairs reduce a spread of 0.2, with all layers known or without the low layer."""
    gains = unequal(0.2)
    assert np.sqrt(np.mean((learnt(gains, known).brightness - gains) ** 2)) < left


def test_dead_leds_are_dark() -> None:
    gains = EQUAL.copy()
    gains.ravel()[np.random.default_rng(2).permutation(256)[:38]] = 0.0
    found = learnt(gains, 256).brightness
    assert found[gains == 0].max() < 0.35
    assert found[gains == 1].min() > 0.7
    assert found.min() >= 0.02


@pytest.mark.parametrize(("known", "pulled"), [(64, 0.0), (256, 0.0), (64, 0.1), (256, 0.1), (256, 0.3)])
def test_equal_leds_are_equal(known: int, pulled: float) -> None:
    """Noise, and poses biased by a bright background, leave brightness at 1."""
    assert (learnt(EQUAL, known, pulled=pulled).brightness == 1).all()


def test_packets_add_up_and_fade() -> None:
    gains = unequal(0.2)
    first = learnt(gains, 256)
    both = learnt(gains, 256, first, blocks=1)
    errors = [np.sqrt(np.mean((gained.brightness - gains) ** 2)) for gained in (first, both)]
    assert errors[1] < 0.85 * errors[0]
    assert information_of(both).trace() > 1.8 * information_of(first).trace()
    faded = both.faded()
    assert np.array_equal(faded.brightness, both.brightness)
    assert information_of(faded).trace() == pytest.approx(0.9 * information_of(both).trace())


def test_learning_restarts_without_evidence() -> None:
    gains = unequal(0.2)
    complete = learnt(gains, 256)
    values_only = complete.without_evidence
    assert np.array_equal(values_only.brightness, complete.brightness)
    assert information_of(complete).any()
    assert values_only.data is None
    assert not values_only.known
    assert not LedGains.sound(SIDE).known
    assert np.array_equal(values_only.faded().brightness, complete.brightness)
    again = learnt(gains, 256, values_only)
    assert np.corrcoef(again.brightness.ravel(), gains.ravel())[0, 1] > 0.9


def test_brightness_stays_without_evidence_of_pairs(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: float) -> None:
        raise np.linalg.LinAlgError

    values_only = learnt(unequal(0.2), 256).without_evidence
    monkeypatch.setattr(led_gains, "_without_nuisance", fail)
    after = learnt(unequal(0.2), 256, values_only)
    assert np.array_equal(after.brightness, values_only.brightness)
    # the packet still counts, so that learning ends
    assert after.packets == 1


def test_undecoded_packets_teach_no_brightness() -> None:
    found = learnt(unequal(0.2), 0)
    assert (found.brightness == 1).all()
    assert found.data is None


@pytest.mark.slow
def test_the_low_layer_of_unequal_leds_is_read() -> None:
    """With gains from headers only, the low layer fails in all packets."""
    settings = link("receive.receiver=soft", distance_m=95.0, arrays=[{"x_m": 0.0, "y_m": 0.0, "spread": 0.2}])
    packets = list(receive_frames(film(settings, 301, roi_margin_px=24), settings.signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok"] * 3
