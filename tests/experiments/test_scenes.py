"""Hard scenes: distinct settings, and counts per scene and distance."""

from heliograph.experiments.error_rates import scenes
from heliograph.experiments.report import Context
from heliograph.measure.counts import BlockCounts, LayerCounts


def test_all_scenes_have_different_settings() -> None:
    found = [scenes.scene_settings(name, 50.0) for name in scenes.SCENES]
    assert all(one not in found[:k] for k, one in enumerate(found))
    assert {one.receive.receiver for one in found} == {"soft"}
    assert len(scenes.scene_settings("six arrays", 50.0).channel.arrays) == 6


def test_blocks_are_counted_by_scene_and_distance() -> None:
    found = scenes.measure(["upright"], [30.0, 300.0], range(2), "plain", Context())
    near, far = found["upright", 30.0], found["upright", 300.0]
    assert (near.layers["middle"].codewords, near.layers["middle"].codeword_errors) == (4, 0)
    assert far.layers["high"].missed == 2


def test_a_line_names_wrong_missed_and_false_codewords() -> None:
    layers = {"high": LayerCounts(codewords=6), "low": LayerCounts(codewords=6, codeword_errors=3, missed=1)}
    text = scenes.counts_text(BlockCounts(layers, false_codewords=2))
    assert text.startswith("high 0/6 [0.0e+00, ")
    assert "low 3/6 (1 missed) [" in text
    assert text.endswith("false codewords 2, packets of nothing 0")
