"""Packet formats signalled in headers: code rates, and packets without inverses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scenes import codewords, film, link, received, words_of

from heliograph.link.settings import LinkSettings
from heliograph.measure.bench import run_block
from heliograph.signal.formats import Format


def soft(formats: str, *changes: str, **channel: Any) -> LinkSettings:
    return link(f"transmit.formats={formats}", "receive.receiver=soft", "signal.data_pairs=24", *changes, **channel)


@pytest.mark.slow
def test_receiver_needs_no_code_rates() -> None:
    """Packets alternate between three formats; the receiver knows only format 0."""
    formats = "[{high='3/4', middle='1/2', low='2/5'}, {}, {high='9/10', middle='9/10', low='9/10'}]"
    settings = soft(formats, distance_m=40.0)
    counts = run_block(settings, 1, max_packets=3)
    # higher rates give longer codewords, not more
    assert [(layer.codewords, layer.codeword_errors) for layer in counts.layers.values()] == [(3, 0), (6, 0), (3, 0)]
    assert counts.false_codewords == 0
    rates = {"high": (0.75, 1 / 3, 0.9), "middle": (0.5, 1 / 3, 0.9), "low": (0.4, 1 / 3, 0.9)}
    for name, layer in counts.layers.items():
        sent = sum(rate * (3072 if name == "middle" else 1536) for rate in rates[name])
        assert abs(layer.bits - sent) < 200


@pytest.mark.parametrize(("fps", "start_s"), [(1000.0, 2e-4), (1500.0, 8e-4)])
@pytest.mark.slow
def test_formats_are_read_from_unsynchronised_headers(fps: float, start_s: float) -> None:
    """Dimmed cells must not shift the light clock, and combined frames scale cells differently from pairs."""
    camera = f"channel.camera.fps={fps}", f"channel.camera.exposure_s={int(1e6 / fps)}e-6"
    changes = "signal.data_pairs=48", *camera, f"channel.arrays.0.start_s={start_s}"
    settings = soft("[{high='1/2', middle='2/5', low='2/5'}]", *changes, distance_m=60.0)
    assert codewords(settings, 2) == [(1, 0), (2, 0), (1, 0)]


@pytest.mark.parametrize(("receiver", "mode", "reason"), [
    ("plain", 2, "its mode, short, has 13 data pairs, and signal.data_pairs is 24: set it to 13"),
    ("soft", 3, "its mode, 3, is not known to this version"),
])  # fmt: skip
@pytest.mark.slow
def test_unreadable_mode_is_ignored(receiver: str, mode: int, reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Data of an unknown mode must be ignored even if they resemble data pairs."""
    settings = soft("[{}, {high='1/2'}]", f"receive.receiver={receiver}", distance_m=35.0)
    with monkeypatch.context() as sent:
        # the second packet signals a future mode but uses current coding
        sent.setattr(Format, "number", property(lambda form: 512 * mode if form.high else 0))
        sent.setattr(Format, "rates", lambda _, agreed: (agreed.high, agreed.middle, agreed.low))
        frames = film(settings, 160, roi_margin_px=12)
    packets = received(frames, settings)
    assert [(packet.status, packet.reason) for packet in packets] == [("ok", ""), ("crc_fail", reason), ("ok", "")]
    assert all(word.block is None for word in words_of(packets[1]))


FAST = "[{mode='single', high='9/10', middle='3/4', low='1/2'}]"


@pytest.mark.slow
def test_rates_of_167_kb_s_are_read_at_80_m() -> None:
    """Near channel capacity: a clock error of a few hundredths of a pattern would lose most codewords."""
    settings = link(f"transmit.formats={FAST}", "receive.receiver=soft", distance_m=80.0)
    counts = run_block(settings, 1, max_packets=1)
    assert [(layer.codewords, layer.codeword_errors) for layer in counts.layers.values()] == [(1, 0), (2, 0), (1, 0)]
    assert counts.layers["high"].raw_errors < 0.01 * counts.layers["high"].raw_bits


@pytest.mark.parametrize(("rates", "other", "channel"), [
    ("1/2", ", {}", {"distance_m": 60.0}), ("9/10", ", {}", {"distance_m": 40.0}),
    # 50 km/h on a rough road; the dimmed header leaves the gain unchanged
    ("1/2", "", {"distance_m": 52.0, "speed_m_s": 14.0, "stop_m": 46.0, "shake": "road", "road_class": "C"}),
    ("1/2", "", {"arrays": [{"x_m": 0.0, "y_m": 0.0, "yaw_deg": 30.0}]}),
    ("1/2", "", {"arrays": [{"x_m": 0.0, "y_m": 0.0, "dead": 0.05}]}),
], ids=["1/2", "9/10", "moving", "tilted", "dead LEDs"])  # fmt: skip
@pytest.mark.slow
def test_packets_without_inverses_are_read(rates: str, other: str, channel: dict[str, Any]) -> None:
    formats = f"[{{mode='single', high='{rates}', middle='{rates}', low='{rates}'}}{other}]"
    assert codewords(soft(formats, **channel), max_packets=2) == [(2, 0), (4, 0), (2, 0)]


@pytest.mark.slow
def test_dimmed_headers_do_not_turn_the_array() -> None:
    """A second header pair dimmed on one side resembled a tilt and dead LEDs."""
    assert codewords(soft(FAST, distance_m=70.0), seed=2, max_packets=1) == [(1, 0), (2, 0), (1, 0)]


def test_occlusion_is_not_taken_for_the_background_without_inverses() -> None:
    settings = soft("[{mode='single'}]", distance_m=70.0)
    rng, frames = np.random.default_rng(0), film(settings, 53, roi_margin_px=20)
    for k in range(20, 28):
        gray = np.clip(np.round(200 + rng.normal(0, 1.5, frames[k].pixels.shape)), 0, 255).astype(np.uint8)
        frames[k] = replace(frames[k], pixels=gray)
    (packet,) = received(frames, settings)
    assert packet.pairs_seen < 0.9
    assert packet.status == "ok"
