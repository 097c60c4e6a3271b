import asyncio

import pytest
from web_fuzz import GOOD, answer, fuzz, served


@pytest.mark.slow
@pytest.mark.usefixtures("quick_ends")
def test_malformed_requests_and_messages_have_valid_outcomes() -> None:
    found = asyncio.run(fuzz(requests=140, conversations=40, seed=3))
    assert set(found) <= GOOD
    assert found.total() == 180


def test_interrupted_upload_is_reported() -> None:
    headers = [(b"host", b"127.0.0.1:8000"), (b"authorization", b"Bearer a-token"), (b"content-length", b"12")]
    assert asyncio.run(answer(served(), "POST", "/api/transmit", headers, [b"a te", None])) == 400
