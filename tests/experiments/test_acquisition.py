import pytest

from heliograph.experiments.detection.acquisition import Acquired, AcquisitionTrial, acquire, outcomes_text


@pytest.mark.slow
def test_an_array_is_found_by_its_first_header() -> None:
    assert acquire(AcquisitionTrial(seed=0, within=5)).headers == 1


@pytest.mark.parametrize("seed", [135, 586])
@pytest.mark.slow
def test_a_pair_of_data_before_a_header_is_not_taken_for_its_first(seed: int) -> None:
    """In these trials the last data pair resembles a header pair, and replaced it before the header was complete."""
    assert acquire(AcquisitionTrial(seed=seed, within=20)).headers == 1


def test_an_array_out_of_reach_is_missed() -> None:
    far = ("channel.distance_m=900", "signal.data_pairs=8")
    assert acquire(AcquisitionTrial(seed=0, within=5, changes=far)).headers == 0


def test_outcomes_are_counted_by_header() -> None:
    text = outcomes_text([Acquired(1, 0), Acquired(2, 3), Acquired(0, 1)])
    assert text.startswith("3 trials: by the first header 1, by the second 1, missed 1 [")
    assert text.endswith("wrong detections 4")
