"""Array sizes other than 16 x 16, end to end."""

from typing import Any

import pytest
from scenes import film, link

from heliograph.link.settings import LinkSettings
from heliograph.measure.bench import run_block
from heliograph.receive import receive_frames

DATA_PAIRS = {4: 100, 8: 48, 32: 8}
"""Data pairs for at least one codeword per layer."""


def sized(side: int, receiver: str, distance_m: float, *changes: str, **channel: Any) -> LinkSettings:
    return link(
        f"signal.side={side}",
        f"signal.data_pairs={DATA_PAIRS[side]}",
        f"receive.receiver={receiver}",
        *changes,
        distance_m=distance_m,
        **{"camera": {"width": 160, "height": 160}, **channel},
    )


def assert_all_read(settings: LinkSettings, packets: int = 1, seed: int = 1) -> None:
    counts = run_block(settings, seed, max_packets=packets)
    assert {name: (c.codewords, c.codeword_errors) for name, c in counts.layers.items()} == {
        "high": (packets, 0),
        "middle": (2 * packets, 0),
        "low": (packets, 0),
    }
    assert counts.false_codewords == counts.false_packets == 0
    assert all(bits > 0 for bits in counts.payload_bits.values())


@pytest.mark.parametrize(
    ("side", "receiver", "distance_m"),
    [
        (4, "plain", 15.0),
        (4, "soft", 20.0),
        (8, "plain", 30.0),
        (8, "plain", 45.0),
        (8, "soft", 30.0),
        (8, "soft", 85.0),
        (32, "plain", 30.0),
        (32, "plain", 50.0),
        (32, "soft", 50.0),
        (32, "soft", 95.0),
    ],
)
@pytest.mark.slow
def test_every_codeword_is_read(side: int, receiver: str, distance_m: float) -> None:
    assert_all_read(sized(side, receiver, distance_m), 2 if side < 32 else 1)


@pytest.mark.parametrize(("side", "distance_m"), [(8, 50.0), (32, 60.0)])
@pytest.mark.parametrize(("fps", "start_s"), [(1000.0, 4e-4), (1500.0, 2e-4)])
@pytest.mark.slow
def test_out_of_step(side: int, distance_m: float, fps: float, start_s: float) -> None:
    camera = {"width": 160, "height": 160, "fps": fps, "exposure_s": 1 / fps}
    arrays = [{"x_m": 0.0, "y_m": 0.0, "start_s": start_s}]
    assert_all_read(sized(side, "soft", distance_m, camera=camera, arrays=arrays))


@pytest.mark.parametrize(("side", "distance_m"), [(8, 40.0), (32, 50.0)])
@pytest.mark.slow
def test_without_inverses(side: int, distance_m: float) -> None:
    assert_all_read(sized(side, "soft", distance_m, "transmit.formats=[{mode='single'}]"))


@pytest.mark.parametrize(("side", "distance_m"), [(8, 50.0), (32, 60.0)])
@pytest.mark.slow
def test_a_quarter_hidden(side: int, distance_m: float) -> None:
    arrays = [{"x_m": 0.0, "y_m": 0.0, "hidden": (0.0, 0.0, 0.5, 0.5)}]
    assert_all_read(sized(side, "soft", distance_m, arrays=arrays))


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.parametrize(("side", "distance_m"), [(8, 40.0), (32, 40.0)])
@pytest.mark.slow
def test_distance_and_place(side: int, distance_m: float, receiver: str) -> None:
    settings = sized(side, receiver, distance_m)
    patterns = settings.signal.packet_patterns
    (packet,) = receive_frames(film(settings, patterns + 1), settings.signal, settings.receive)
    assert (packet.status, packet.pairs_seen) == ("ok", 1)
    assert packet.distance_m == pytest.approx(distance_m, rel=0.01)
    assert (packet.pose.x, packet.pose.y) == pytest.approx((79.5, 79.5), abs=0.05)
