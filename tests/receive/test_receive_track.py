"""Tracking: shake, hidden arrays, missing frames, cut films."""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from receive_scenes import drawn_film, film, link
from scipy.ndimage import gaussian_filter1d

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import Packet, Pose, receive_frames
from heliograph.receive.track import TrackedPair, contrast

Floats = NDArray[np.float64]

SHORT = "signal.data_pairs=16"


class Watch:
    """Observer that keeps where the array was said to be."""

    def __init__(self) -> None:
        self.tracked: list[TrackedPair] = []
        self.lost: list[float] = []
        self.found: list[float] = []

    def __call__(self, stage: str, data: Mapping[str, Any], /) -> None:
        if stage == "track":
            self.tracked.append(data["tracked"])
        elif stage == "lost":
            self.lost.append(data["time_s"])
        elif stage == "detect":
            self.found.append(data["detection"].start_time_s)

    def errors(self, path: Any) -> Floats:
        """Error of the position in px at each pair, (pairs, 2); a time is the start of an exposure of 1 ms."""
        times = np.array([t.state.time_s for t in self.tracked])
        places = np.array([(t.state.pose.x, t.state.pose.y) for t in self.tracked])
        return np.asarray(places - path(times + 0.5e-3), np.float64)


def still(t: Floats) -> Floats:
    return np.stack([47.3 + 0 * t, 48.8 + 0 * t], -1)


def shaking(t: Floats) -> Floats:
    """At most 0.9 px/ms, 40 Hz."""
    reach = 900 / (2 * np.pi * 40)
    return np.stack([47.3 + reach * np.sin(2 * np.pi * 40 * t), 48.8 + 0.5 * reach * np.cos(2 * np.pi * 40 * t)], -1)


def read(frames: Iterable[Frame], settings: LinkSettings) -> tuple[list[Packet], Watch]:
    watch = Watch()
    return list(receive_frames(frames, settings.signal, settings.receive, watch)), watch


def good(packet: Packet, layer: str) -> bool:
    return all(word.status == "ok" for word in packet.layers[layer])


@pytest.mark.parametrize("distance_m", [25.0, 40.0, 80.0])
def test_hard_shake_is_followed(distance_m: float) -> None:
    settings = link()
    packets, watch = read(drawn_film(settings, 200, shaking, distance_m=distance_m), settings)
    assert [good(p, "high") for p in packets] == [True, True]
    assert watch.lost == []
    assert all(t.seen for t in watch.tracked)
    assert np.sqrt(np.mean(watch.errors(shaking)[3:] ** 2)) < 0.1


@pytest.mark.parametrize("distance_m", [40.0, 80.0])
def test_at_rest_the_position_is_sharp(distance_m: float) -> None:
    settings = link(SHORT)
    _, watch = read(drawn_film(settings, 72, still, distance_m=distance_m), settings)
    assert np.sqrt(np.mean(watch.errors(still)[3:] ** 2)) < 0.02


def test_hidden_for_30_ms_is_coasted_over() -> None:
    settings = link()
    packets, watch = read(drawn_film(settings, 200, still, hidden=[range(40, 70)]), settings)
    assert watch.lost == []
    assert len(watch.found) == 1
    assert good(packets[0], "high")
    assert packets[0].pairs_seen == pytest.approx(1 - 15 / 48)
    assert packets[1].status == "ok"
    assert [t.seen for t in watch.tracked[20:35]] == [False] * 15


def test_hidden_for_200_ms_is_lost_and_found_again() -> None:
    settings = link()
    packets, watch = read(drawn_film(settings, 420, still, hidden=[range(80, 280)]), settings)
    assert len(watch.lost) == 1
    assert 0.12 < watch.lost[0] < 0.14
    assert watch.found == pytest.approx([0.0, 0.3])
    assert [round(p.start_time_s, 6) for p in packets] == [0.0, 0.3]
    assert packets[0].pairs_seen == pytest.approx(38 / 48)
    assert packets[1].status == "ok"


@pytest.mark.parametrize("missing", [{30}, {31}, {30, 31}, {98, 99}, {99}, {51, 60}])
def test_missing_frames_cost_their_pairs(missing: set[int]) -> None:
    settings = link()
    packets, watch = read((f for f in film(settings, 204) if f.index not in missing), settings)
    lost = len({k // 2 for k in missing})
    assert [p.pairs_seen for p in packets] == pytest.approx([1 - lost / 48, 1])
    assert [p.status for p in packets] == ["ok", "ok"]
    assert [round(p.start_time_s, 6) for p in packets] == [0.0, 0.1]
    assert len(watch.found) == 1


@pytest.mark.parametrize("missing", [range(70, 110), range(96, 104), range(60, 240), range(150, 270), range(50, 190)])
def test_long_gap_keeps_packets_apart(missing: range) -> None:
    settings = link()
    packets, _ = read((f for f in film(settings, 400) if f.index not in missing), settings)
    for packet in packets:
        # frames of one packet only, and of that which its start names
        first = round(packet.start_time_s * 1000)
        assert first % 100 == 0
        assert first <= packet.first_frame <= packet.last_frame < first + 100
    starts = [round(p.start_time_s, 6) for p in packets]
    assert starts == sorted(set(starts))
    whole = [k for k in range(4) if not set(missing) & set(range(100 * k, 100 * k + 100))]
    assert {round(0.1 * k, 6) for k in whole} <= {s for p, s in zip(packets, starts, strict=True) if p.status == "ok"}


@pytest.mark.parametrize(("frames", "packets"), [(51, 0), (52, 1), (99, 1), (100, 1), (151, 1), (152, 2)])
def test_film_cut_within_a_packet(frames: int, packets: int) -> None:
    settings = link()
    got, _ = read(film(settings, frames), settings)
    # of 48 data pairs after 2 of header, 24 are enough to try
    assert len(got) == packets
    rest = min((frames % 100) // 2 - 2, 48)
    if packets and rest > 0:
        assert got[-1].pairs_seen == pytest.approx(rest / 48 if rest >= 24 else 1)


def test_array_that_goes_out_of_the_picture_is_lost() -> None:
    def leaving(t: Floats) -> Floats:
        return np.stack([47.3 + 500 * t, 48.8 + 0 * t], -1)

    settings = link()
    packets, watch = read(drawn_film(settings, 260, leaving), settings)
    assert len(watch.lost) == 1
    assert all(p.start_time_s < 0.2 for p in packets)


def test_what_is_no_array_is_given_up() -> None:
    settings = link(SHORT)
    rng = np.random.default_rng(0)
    frames = film(settings, 6)
    flicker = [Frame(k, k * 1e-3, rng.integers(0, 200, (120, 160)).astype(np.uint8)) for k in range(6, 160)]
    packets, watch = read([*frames, *flicker], settings)
    assert len(watch.found) == len(watch.lost) == 1
    assert len(packets) <= 3
    assert all(word.status != "ok" for p in packets for words in p.layers.values() for word in words)


@pytest.mark.parametrize(("pitch", "blur"), [(0.3, 0.5), (0.7, 0.5), (4.0, 0.2)])
def test_contrast_is_what_blur_leaves_of_a_cell(pitch: float, blur: float) -> None:
    x = np.linspace(-20, 20, 40001)
    sharp = (np.abs(x) < pitch).astype(float)
    sigma = np.hypot(blur, 12**-0.5)
    blurred = gaussian_filter1d(sharp, sigma / (x[1] - x[0]), mode="constant")
    # along x and along y
    left = ((blurred**2).sum() / (sharp**2).sum()) ** 2
    assert contrast(Pose(0, 0, pitch, 0, blur)) == pytest.approx(np.sqrt(left), rel=1e-2)
