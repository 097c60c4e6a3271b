"""LLR calibration: bit counts, verdicts, and a known channel."""

import io
import json

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.experiments import calibration, known_receiver
from heliograph.experiments.calibration import CalibrationFilm, calibrated, count_bits, reliability_bins
from heliograph.experiments.report import Context
from heliograph.link.settings import load_settings


def bits_of(factor: float, packets: int = 20) -> list[NDArray[np.float64]]:
    """Count bits with LLRs scaled by `factor`."""
    rng, out = np.random.default_rng(0), []
    for _ in range(packets):
        sent = rng.integers(0, 2, 3000).astype(np.uint8)  # y = +-1 + n with variance s^2: LLR = 2 y / s^2
        y = 1.0 - 2 * sent + rng.normal(0, 0.8, 3000)
        out.append(count_bits(factor * 2 * y / 0.64, sent))
    return out


def test_bits_are_counted_by_their_predicted_error_probability() -> None:
    counts = count_bits(np.array([0.0, 2.0, -2.0, 2.0, 20.0]), np.array([0, 0, 0, 1, 0], np.uint8))
    bins = {one.edges: one for one in reliability_bins([counts])}
    middle = bins[0.1, 0.2]  # 1 / (1 + e^2) = 0.119
    assert (middle.count.trials, middle.count.errors) == (3, 2)
    assert middle.predicted == pytest.approx(1 / (1 + np.exp(2)))
    assert (bins[0.0, 1e-4].count.trials, bins[0.0, 1e-4].count.errors) == (1, 0)
    assert (sum(one.count.trials for one in bins.values()), len(bins)) == (4, len(calibration.EDGES) - 1)


def test_only_a_true_prediction_holds() -> None:
    for factor, verdict in ((1.0, "holds"), (1.5, "differs"), (0.7, "differs")):
        finding = calibrated("", reliability_bins(bits_of(factor)))
        assert (finding.verdict, bool(finding.why)) == (verdict, verdict == "differs")
    assert calibrated("", reliability_bins([])).verdict == "shown"


def test_a_film_is_received_and_compared() -> None:
    changes = ["receive.receiver=soft", "receive.soft.led_by_led=false", "channel.distance_m=90"]
    settings = load_settings("static", None, changes)
    found = calibration.record(CalibrationFilm(case="x", settings=settings, seed=1))
    first, last = (np.sum(found.reliability[name], 0) for name in (calibration.FIRST, calibration.LAST))
    assert first[0].sum() == 48 * 256  # 48 pairs of 256 symbols; later those of codewords that failed
    assert 0 < last[0].sum() < 48 * 256
    assert first[1].sum() == pytest.approx(first[2].sum(), rel=0.15)
    ((true, distance, number),) = found.distances
    assert (true, number) == (90, 0)
    assert distance == pytest.approx(90, abs=1)


@pytest.mark.slow
def test_packets_at_rest_and_driving_give_a_result() -> None:
    chosen = [film for film in calibration.all_films(Context()) if film.settings.channel.distance_m == 80]
    films = [chosen[0], chosen[-1]]
    assert [film.case for film in films] == ["at rest", "driving"]
    result = calibration.run(Context(), films)
    assert json.loads(json.dumps(result.data))
    assert [f.verdict for f in result.findings][-1] == "holds"
    assert "4 packets" in result.findings[-1].ours
    for figure, caption in result.pictures:
        figure.savefig(io.BytesIO(), format="png", dpi=10)
        assert caption
    assert all(table.rows and {len(row) for row in table.rows} == {len(table.head)} for table in result.tables)


@pytest.mark.parametrize(("distance_m", "wrong"), [(80.0, 0), (150.0, 1)])
@pytest.mark.slow
def test_the_known_channel_reads_as_well_as_the_estimated_channel(distance_m: float, wrong: int) -> None:
    tasks = known_receiver.tasks(distance_m, "low", [1.0], 1)
    assert [(task.known, task.brightness) for task in tasks] == [(False, 1.0), (True, 1.0)]
    for task in tasks:
        count = known_receiver.measure(task)
        assert (count.trials, count.errors) == (1, wrong)
