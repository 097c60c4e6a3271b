"""The format that a header names, as the soft receiver reads it; and packets of formats it was not told of."""

from collections.abc import Sequence

import numpy as np
import pytest
from receive_scenes import draw, frame_of, link, pitch_at

from heliograph.measure.bench import run_block
from heliograph.receive import Pose
from heliograph.receive.soft.naming import NameReader
from heliograph.signal.formats import AGREED, format_of, words
from heliograph.signal.header import header_levels, signalling_levels


def seen(number: int, reader: NameReader, pairs: Sequence[int], distance_m: float, seed: int = 0) -> None:
    """Show a reader header pairs of identity 7, the array on its way by a third of a pixel a frame."""
    rng = np.random.default_rng(seed)
    for pair in pairs:
        levels = signalling_levels(7, number) if pair else header_levels(7)
        x, y = 40 + rng.uniform(-0.5, 0.5, 2)
        poses = [Pose(x + 0.3 * k, y - 0.2 * k, pitch_at(distance_m), 0.01, 0.52) for k in (0, 1)]
        shown = [
            0.1 + 0.8 * draw(p, one / 4, (0, 0), (80, 80)) for p, one in zip(poses, (levels, 4 - levels), strict=True)
        ]
        up, down = (frame_of(light, k, rng) for k, light in enumerate(shown))
        reader.take(pair, up, down, (poses[0], poses[1]))


@pytest.mark.parametrize("distance_m", [40.0, 120.0, 200.0])
def test_formats_are_read(distance_m: float) -> None:
    for number in (*range(1, len(words()), 37), len(words()) - 1):
        reader = NameReader(7, 16)
        seen(number, reader, (0, 1), distance_m, seed=number)
        assert reader.named(1.0) == format_of(number)


def test_gain_is_told_where_the_first_pair_was_not_seen() -> None:
    reader = NameReader(7, 16)
    seen(0o765, reader, (1,), 120.0)
    assert reader.named(0.8 * 255) == format_of(0o765)
    # with all cells dimmed or none, the gain decides
    assert reader.named(0.8 * 255) != reader.named(0.4 * 255)


def test_without_a_later_pair_the_agreed_format_is_assumed() -> None:
    reader = NameReader(7, 16)
    assert reader.named(1.0) == AGREED
    seen(0o765, reader, (0,), 80.0)
    assert reader.named(1.0) == AGREED


def test_a_receiver_needs_no_rates() -> None:
    """Packets take three formats in turn; the receiver knows only what format 0 means."""
    formats = "[{high='3/4', middle='1/2', low='2/5'}, {}, {high='9/10', middle='9/10', low='9/10'}]"
    settings = link(f"transmit.formats={formats}", "receive.receiver=soft", distance_m=40.0)
    counts = run_block(settings, 1, max_packets=3)
    # codewords are longer at higher rates, not more
    assert {name: (c.codewords, c.codeword_errors) for name, c in counts.layers.items()} == {
        "high": (3, 0),
        "middle": (6, 0),
        "low": (3, 0),
    }
    assert counts.false_codewords == 0
    rates = {"high": (0.75, 1 / 3, 0.9), "middle": (0.5, 1 / 3, 0.9), "low": (0.4, 1 / 3, 0.9)}
    for name, layer in counts.layers.items():
        sent = sum(rate * (6144 if name == "middle" else 3072) for rate in rates[name])
        assert abs(layer.bits - sent) < 200


@pytest.mark.parametrize(
    ("fps", "start_s"), [(1000.0, 0.0), (1000.0, 2e-4), (1500.0, 8e-4), (2000.0, 2e-4), (2000.0, 6e-4)]
)
def test_formats_are_read_out_of_step(fps: float, start_s: float) -> None:
    """Dimmed cells make a header neither early nor late, and combined frames show them otherwise than pairs do."""
    settings = link(
        "transmit.formats=[{high='1/2', middle='2/5', low='2/5'}]",
        "receive.receiver=soft",
        f"channel.camera.fps={fps}",
        f"channel.camera.exposure_s={int(1e6 / fps)}e-6",
        f"channel.arrays.0.start_s={start_s}",
        distance_m=60.0,
    )
    counts = run_block(settings, 2)
    assert [(c.codewords, c.codeword_errors) for c in counts.layers.values()] == [(1, 0), (2, 0), (1, 0)]
