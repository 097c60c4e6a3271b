"""Soft receiver with packets without inverses."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import film, link

from heliograph.measure.bench import run_block
from heliograph.receive import receive_frames


@pytest.mark.parametrize(("rates", "distance_m"), [("1/2", 60.0), ("9/10", 40.0)])
@pytest.mark.slow
def test_packets_without_inverses_are_read(rates: str, distance_m: float) -> None:
    formats = f"[{{mode='single', high='{rates}', middle='{rates}', low='{rates}'}}, {{}}]"
    settings = link(f"transmit.formats={formats}", "receive.receiver=soft", distance_m=distance_m)
    counts = run_block(settings, 1, max_packets=2)
    assert {n: (c.codewords, c.codeword_errors) for n, c in counts.layers.items()} == {
        "high": (2, 0),
        "middle": (4, 0),
        "low": (2, 0),
    }
    assert counts.false_codewords == 0


def test_rates_of_167_kb_s_are_read_at_80_m() -> None:
    """Near channel capacity: a clock error of a few hundredths of a pattern would lose most codewords."""
    formats = "[{mode='single', high='9/10', middle='3/4', low='1/2'}]"
    counts = run_block(link(f"transmit.formats={formats}", "receive.receiver=soft", distance_m=80.0), 1, max_packets=1)
    assert [(c.codewords, c.codeword_errors) for c in counts.layers.values()] == [(1, 0), (2, 0), (1, 0)]
    assert counts.layers["high"].raw_errors < 0.01 * counts.layers["high"].raw_bits


@pytest.mark.slow
def test_a_moving_array_is_followed_without_inverses() -> None:
    """50 km/h on a rough road, over consecutive packets; the dimmed header leaves the gain unchanged."""
    settings = link(
        "transmit.formats=[{mode='single', high='1/2', middle='1/2', low='1/2'}]",
        "receive.receiver=soft",
        distance_m=52.0,
        speed_m_s=14.0,
        stop_m=46.0,
        shake="road",
        road_class="C",
    )
    counts = run_block(settings, 1, max_packets=2)
    assert counts.layers["high"].codewords == 2
    assert sum(layer.codeword_errors for layer in counts.layers.values()) == 0


@pytest.mark.parametrize("place", [{"yaw_deg": 30.0}, {"dead": 0.05}])
@pytest.mark.slow
def test_tilt_and_dead_leds_are_known_from_headers(place: dict[str, float]) -> None:
    settings = link(
        "transmit.formats=[{mode='single', high='1/2', middle='1/2', low='1/2'}]",
        "receive.receiver=soft",
        distance_m=50.0,
        arrays=[{"x_m": 0.0, "y_m": 0.0, **place}],
    )
    counts = run_block(settings, 1, max_packets=2)
    assert counts.layers["high"].codewords == 2
    assert [layer.codeword_errors for layer in counts.layers.values()] == [0, 0, 0]
    assert counts.false_codewords == 0


@pytest.mark.parametrize("seed", [2, 7])
@pytest.mark.slow
def test_dimmed_headers_do_not_turn_the_array(seed: int) -> None:
    """A second header pair dimmed on one side resembled a tilt and dead LEDs."""
    formats = "[{mode='single', high='9/10', middle='3/4', low='1/2'}]"
    settings = link(f"transmit.formats={formats}", "receive.receiver=soft", distance_m=70.0)
    counts = run_block(settings, seed, max_packets=1)
    assert [(c.codewords, c.codeword_errors) for c in counts.layers.values()] == [(1, 0), (2, 0), (1, 0)]


def test_what_passes_before_an_array_is_not_its_background() -> None:
    settings = link("transmit.formats=[{mode='single'}]", "receive.receiver=soft", distance_m=70.0)
    rng, frames = np.random.default_rng(0), film(settings, 101)
    for k in range(30, 44):
        gray = np.clip(np.round(200 + rng.normal(0, 1.5, frames[k].pixels.shape)), 0, 255).astype(np.uint8)
        frames[k] = replace(frames[k], pixels=gray)
    (packet,) = receive_frames(frames, settings.signal, settings.receive)
    assert packet.pairs_seen < 0.9
    assert packet.status == "ok"
