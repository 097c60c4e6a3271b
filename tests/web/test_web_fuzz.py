import asyncio

import pytest
from web_fuzz import GOOD, answer, fuzz, served


@pytest.mark.slow
def test_malformed_requests_and_messages_have_valid_outcomes() -> None:
    found = asyncio.run(fuzz(150, seed=3))
    assert {outcome for counts in found.values() for outcome in counts} <= set(GOOD)
    assert sum(counts.total() for counts in found.values()) == 150


def test_interrupted_upload_is_reported() -> None:
    headers = [(b"host", b"127.0.0.1:8000"), (b"authorization", b"Bearer a-token"), (b"content-length", b"12")]
    assert asyncio.run(answer(served(), "POST", "/api/transmit", headers, [b"a te", None])) == 400
