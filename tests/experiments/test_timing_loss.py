"""Computed loss for an asynchronous camera."""

import pytest

from heliograph.experiments.patterns.timing_loss import table, timing_loss


def test_loss_grows_as_frames_straddle_patterns_and_is_small_for_many_frames() -> None:
    expected = {"slope": 1.0, "noise": 1.0, "loss (dB)": 0.0, "around": 0.0, "rest": 0.0, "bits": 1.0, "header": 1.0}
    in_step = timing_loss(1.0, 1.0, 0.0)
    assert {name: in_step[name] for name in expected} == pytest.approx(expected, abs=1e-6)
    losses = [timing_loss(1.0, 1.0, phase)["loss (dB)"] for phase in (0.1, 0.2, 0.3, 0.4)]
    assert losses == sorted(losses)
    assert timing_loss(1.0, 1.0, 0.5)["header"] == pytest.approx(0.0)
    assert max(timing_loss(1.5, 2 / 3, phase)["loss (dB)"] for phase in (0.0, 1 / 6, 1 / 3, 0.5)) < 0


def test_a_table_has_a_row_a_case() -> None:
    losses = [timing_loss(1.0, 1.0, 0.0), timing_loss(2.0, 0.5, 0.0)]
    assert table(losses).rows[0][:5] == ["1", "1.00", "0.00", "1.00", "1.00"]
    assert table(losses).markdown().count("\n") == 3
