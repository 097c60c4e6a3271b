import asyncio

import pytest
from web_fuzz import GOOD, answer, fuzz, served


@pytest.mark.slow
def test_malformed_requests_and_messages_are_answered_refused_or_let_go() -> None:
    found = asyncio.run(fuzz(400, seed=3))
    assert {what for counts in found.values() for what in counts} <= set(GOOD)
    assert sum(counts.total() for counts in found.values()) == 400


def test_a_text_that_breaks_off_is_said_so() -> None:
    headers = [(b"host", b"127.0.0.1:8000"), (b"authorization", b"Bearer a-token"), (b"content-length", b"12")]
    assert asyncio.run(answer(served(), "POST", "/api/transmit", headers, [b"a te", None])) == 400
