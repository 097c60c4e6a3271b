"""Packet formats signalled in headers."""

import pytest
from scenes import film, link

from heliograph.measure.bench import run_block
from heliograph.receive import receive_frames
from heliograph.signal.formats import Format


@pytest.mark.slow
def test_a_receiver_needs_no_rates() -> None:
    """Packets alternate between three formats; the receiver knows only format 0."""
    formats = "[{high='3/4', middle='1/2', low='2/5'}, {}, {high='9/10', middle='9/10', low='9/10'}]"
    settings = link(f"transmit.formats={formats}", "receive.receiver=soft", distance_m=40.0)
    counts = run_block(settings, 1, max_packets=3)
    # higher rates give longer codewords, not more
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
@pytest.mark.slow
def test_formats_are_read_out_of_step(fps: float, start_s: float) -> None:
    """Dimmed cells must not shift the light clock, and combined frames scale cells differently from pairs."""
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


@pytest.mark.parametrize(("mode", "reason"), [
    (2, "its mode, short, has 13 data pairs, and signal.data_pairs is 48: set it to 13"),
    (3, "its mode, 3, is not known to this version"),
])  # fmt: skip
@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.slow
def test_a_packet_of_a_mode_that_cannot_be_read_is_ignored(
    receiver: str, mode: int, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Data of an unknown mode must be ignored even if they resemble data pairs."""
    settings = link(f"receive.receiver={receiver}", "transmit.formats=[{}, {high='1/2'}]")
    with monkeypatch.context() as sent:
        # the second packet signals a future mode but uses current coding
        sent.setattr(Format, "number", property(lambda form: 512 * mode if form.high else 0))
        sent.setattr(Format, "rates", lambda _, agreed: (agreed.high, agreed.middle, agreed.low))
        frames = film(settings, 304)
    packets = list(receive_frames(frames, settings.signal, settings.receive))
    assert [(packet.status, packet.reason) for packet in packets] == [
        ("ok", ""), ("crc_fail", reason), ("ok", ""),
    ]  # fmt: skip
    assert all(word.block is None for words in packets[1].layers.values() for word in words)
