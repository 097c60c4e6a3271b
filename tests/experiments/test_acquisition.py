import pytest

from heliograph.experiments.detection.acquisition import Acquired, AcquisitionTrial, acquire, outcomes_text

FAR = ("channel.distance_m=900", "signal.data_pairs=8")


# in trials 135 and 586 the last data pair resembles a header pair, and replaced it before the header was complete
@pytest.mark.parametrize(("seed", "within", "changes", "headers"), [
    (0, 5, (), 1), (135, 20, (), 1), (586, 20, (), 1), (0, 5, FAR, 0),
])  # fmt: skip
@pytest.mark.slow
def test_arrays_are_found_by_the_first_header(seed: int, within: int, changes: tuple[str, ...], headers: int) -> None:
    assert acquire(AcquisitionTrial(seed=seed, within=within, changes=changes)).headers == headers


def test_outcomes_are_counted_by_header() -> None:
    text = outcomes_text([Acquired(1, 0), Acquired(2, 3), Acquired(0, 1)])
    assert text.startswith("3 trials: by the first header 1, by the second 1, missed 1 [")
    assert text.endswith("wrong detections 4")
