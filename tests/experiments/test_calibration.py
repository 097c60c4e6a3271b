"""The soft receiver's claims: counted rightly, and judged by what was counted."""

import io
import json

import numpy as np
import pytest

from heliograph.experiments.calibration import experiment as soft
from heliograph.experiments.calibration.recorder import EDGES, FIRST, LAST, Block, Claims, listen
from heliograph.experiments.result import Context
from heliograph.link.settings import load_settings


def honest(claims: float, packets: int = 20) -> Claims:
    """Bits whose LLRs are `claims` times what they should be."""
    rng, out = np.random.default_rng(0), Claims()
    for _ in range(packets):
        # y = +-1 + n of variance s^2: LLR = 2 y / s^2
        sent = rng.integers(0, 2, 3000).astype(np.uint8)
        y = 1.0 - 2 * sent + rng.normal(0, 0.8, 3000)
        out.add(claims * 2 * y / 0.64, sent)
    return out


def test_bits_are_counted_by_what_is_claimed() -> None:
    claims = Claims()
    claims.add(np.array([0.0, 2.0, -2.0, 2.0, 20.0]), np.array([0, 0, 0, 1, 0], np.uint8))
    bins = {one.edges: one for one in claims.bins()}
    # 1 / (1 + e^2) = 0.119
    middle = bins[0.1, 0.2]
    assert (middle.count.trials, middle.count.errors) == (3, 2)
    assert middle.claimed == pytest.approx(1 / (1 + np.exp(2)))
    assert (bins[0.0, 1e-4].count.trials, bins[0.0, 1e-4].count.errors) == (1, 0)
    assert sum(one.count.trials for one in bins.values()) == 4
    assert len(bins) == len(EDGES) - 1


@pytest.mark.parametrize(("factor", "verdict"), [(1.0, "holds"), (1.5, "differs"), (0.7, "differs")])
def test_a_claim_holds_only_where_it_is_true(factor: float, verdict: str) -> None:
    finding = soft._likelihood("", honest(factor).bins())
    assert finding.verdict == verdict
    assert bool(finding.why) == (verdict == "differs")


def test_nothing_counted_is_not_judged() -> None:
    assert soft._likelihood("", Claims().bins()).verdict == "shown"


def test_a_block_is_received_and_compared() -> None:
    settings = load_settings("static", None, ["receive.receiver=soft", "channel.distance_m=90"])
    told = listen(Block(case="x", settings=settings, seed=1))
    first, last = (told.claims[name].table.sum(0) for name in (FIRST, LAST))
    # 48 pairs of 256 cells, none known; later those of the codewords that failed
    assert first[0].sum() == 48 * 256
    assert 0 < last[0].sum() < 48 * 256
    assert first[1].sum() == pytest.approx(first[2].sum(), rel=0.15)
    ((true, found, number),) = told.distances
    assert (true, number) == (90, 0)
    assert found == pytest.approx(90, abs=1)


def test_chapter(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(soft, "QUICK_M", (80.0,))
    chapter = soft.run(Context())
    assert chapter.key == "soft"
    assert json.loads(json.dumps(chapter.data))
    assert [f.verdict for f in chapter.findings][-1] == "holds"
    assert "12 packets" in chapter.findings[-1].ours
    for figure, caption in chapter.pictures:
        figure.savefig(io.BytesIO(), format="png", dpi=30)
        assert caption
    for table in chapter.tables:
        assert table.rows
        assert all(len(row) == len(table.head) for row in table.rows)
