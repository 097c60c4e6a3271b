"""Experiments on single patterns: execution, counts, verdicts."""

import io
import json

import numpy as np
import pytest

from heliograph.experiments.patterns import header, inverse, packet, parameters, pwm, received
from heliograph.experiments.report import Context, ExperimentResult
from heliograph.link.settings import load_settings

pytestmark = pytest.mark.slow
MODULES = {"fig3": received, "fig4": pwm, "fig5": packet, "fig7": header, "fig8": inverse, "tables": parameters}


@pytest.fixture(scope="module")
def results() -> dict[str, ExperimentResult]:
    return {key: module.run(Context()) for key, module in MODULES.items()}


@pytest.mark.parametrize("key", MODULES)
def test_results_are_complete(key: str, results: dict[str, ExperimentResult]) -> None:
    done = results[key]
    assert done.findings
    assert all(any(letter.isdigit() for letter in finding.ours) for finding in done.findings)
    assert json.loads(json.dumps(done.data))
    for figure, caption in done.pictures:
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=10)
        assert out.getvalue().startswith(b"\x89PNG")
        assert caption
    assert all(len(row) == len(table.head) for table in done.tables for row in table.rows)


def test_leds_are_resolved_near_only(results: dict[str, ExperimentResult]) -> None:
    contrast = results["fig3"].data["contrast"]
    assert min(contrast["10 m"]) > 0.9
    assert max(contrast["70 m"]) < 0.05
    means = [np.mean(values) for values in contrast.values()]
    assert means[:6] == sorted(means[:6], reverse=True)


def test_exposure_integrates_the_pulses(results: dict[str, ExperimentResult]) -> None:
    data = results["fig4"].data
    assert np.mean(data["1 ms"], 0) == pytest.approx([0, 0.25, 0.5, 0.75, 1], abs=0.01)
    # half of T_b covers two of four slots
    assert np.mean(data["0.5 ms"], 0) == pytest.approx([0, 0.5, 1, 1, 1], abs=0.01)
    assert [f.verdict for f in results["fig4"].findings] == ["holds", "differs"]
    rows = np.linspace(0, 1, 5)[None]
    half = pwm.judge({1e-3: rows, 0.5e-3: rows})[1]
    assert (half.verdict, half.why) == ("holds", "")


def test_packets_hold_headers_and_inverses_and_the_header_is_read_at_25_m(results: dict[str, ExperimentResult]) -> None:
    assert results["fig5"].findings[0].verdict == "holds"
    assert "6 of 6" in results["fig5"].findings[0].ours
    assert "150 of 150" in results["fig5"].findings[0].ours
    assert results["fig7"].data["wrong_cells"]["25 m"] == [0, 160]
    assert {f.verdict for f in results["fig7"].findings} == {"holds"}


def test_sum_is_uniform_unless_leds_saturate(results: dict[str, ExperimentResult]) -> None:
    data = results["fig8"].data
    for distance in ("50 m", "80 m"):
        single, both, on = data[distance]["bright"]
        assert both - on < 0.05 * single
    single, both, on = data["10 m"]["dim"]
    assert both - on < 0.05 * single
    assert "saturate" in results["fig8"].findings[0].why


def test_tables_compare_the_preset(results: dict[str, ExperimentResult]) -> None:
    assert [f.verdict for f in results["tables"].findings] == ["holds", "holds", "holds", "differs"]
    other = load_settings("motorway")
    off = [row[0] for row in parameters.EXPERIMENT if parameters.cells(row, other)[-1] == "no"]
    assert (off, parameters.net_kb_s(other)) == (["vehicle speed", "distance, from"], 128)
