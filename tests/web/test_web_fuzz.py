import asyncio

import pytest
from benchmarks.web_fuzz import GOOD, fuzz


@pytest.mark.slow
def test_malformed_requests_and_messages_are_answered_refused_or_let_go() -> None:
    found = asyncio.run(fuzz(800, seed=3))
    assert {what for counts in found.values() for what in counts} <= set(GOOD)
    assert sum(counts.total() for counts in found.values()) == 800
