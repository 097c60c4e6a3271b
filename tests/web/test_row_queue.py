import asyncio
import threading
from typing import Any

import pytest

from heliograph.web import row_queue
from heliograph.web.row_queue import MAX_ROWS, GoneError, RowQueue


class Page:
    """Page that blocks until released."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self.may = asyncio.Event()

    async def send_json(self, row: Any) -> None:
        await self.may.wait()
        self.rows.append(row)


def test_a_slow_page_holds_up_its_own_worker_alone_and_loses_nothing() -> None:
    async def run() -> tuple[int, list[Any]]:
        page, sent = Page(), [0]
        rows = RowQueue(page)  # type: ignore[arg-type]

        def work() -> None:
            for k in range(MAX_ROWS + 50):
                rows.put({"row": k})
                sent[0] = k + 1

        worker, forward = threading.Thread(target=work), asyncio.ensure_future(rows.forward())
        worker.start()
        await asyncio.sleep(0.3)  # the event loop stays responsive
        held = sent[0]
        page.may.set()
        await asyncio.to_thread(worker.join)
        await rows.end()
        await forward
        return held, page.rows

    held, rows = asyncio.run(run())
    assert held <= MAX_ROWS + 1
    assert [row["row"] for row in rows] == list(range(MAX_ROWS + 50))


def test_a_page_that_takes_nothing_is_taken_for_gone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row_queue, "TIMEOUT_S", 0.05)

    async def run() -> None:
        rows = RowQueue(Page())  # type: ignore[arg-type]

        def work() -> None:
            for k in range(MAX_ROWS + 1):
                rows.put({"row": k})

        await asyncio.to_thread(work)

    with pytest.raises(GoneError):
        asyncio.run(run())


def test_a_worker_ends_where_its_page_is_gone() -> None:
    async def run() -> None:
        rows = RowQueue(Page())  # type: ignore[arg-type]
        rows.cancel()
        await asyncio.to_thread(rows.put, {"row": 0})

    with pytest.raises(GoneError):
        asyncio.run(run())
