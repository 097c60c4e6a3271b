"""Diagnosis for undecoded packets."""

import math

import pytest
from scenes import film, link, received, words_of


@pytest.mark.parametrize(("distance_m", "lacks"), [(40.0, []), (95.0, ["middle", "low"])])
def test_packet_explains_which_codewords_lack_information(distance_m: float, lacks: list[str]) -> None:
    settings = link("receive.receiver=plain", distance_m=distance_m)
    (packet,) = received(film(settings, 101, roi_margin_px=30), settings)
    assert all(0 <= word.information <= 1 for word in words_of(packet))
    failed = [name for name, by in packet.layers.items() if any(word.status != "ok" for word in by)]
    assert failed == lacks
    first, *lines = packet.explain().splitlines()
    assert first.startswith(f"array {packet.identity}, {packet.distance_m:.1f} m")
    assert f"header score {packet.header_score:.2f}" in first
    assert 0 < packet.pose_std_px < 0.5
    assert f"position error {packet.pose_std_px:.2f} px" in first
    assert [line.split()[0] for line in lines] == ["high", "middle", "low"]
    for name, line in zip(packet.layers, lines, strict=True):
        assert ("the code needs about 0.43" in line) == (name in lacks)
        best = max((word.information for word in packet.layers[name] if word.status != "ok"), default=math.nan)
        assert (f"at most {best:.2f} bit per coded bit" in line) == (name in lacks)
