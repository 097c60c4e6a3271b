"""Rows and pictures from a worker thread to a page."""

import asyncio
import json
from collections.abc import Callable
from typing import Any

import pytest

from heliograph.web.connection import Outbox
from heliograph.web.crashes import GoneError
from heliograph.web.stores import BusyError


class Page:
    """WebSocket of a page that accepts no rows until released."""

    def __init__(self, *, is_released: bool = True) -> None:
        self.rows: list[int] = []
        self.pictures: list[bytes] = []
        self.released = asyncio.Event()
        if is_released:
            self.released.set()

    async def send_text(self, row: str) -> None:
        await self.released.wait()
        self.rows.append(json.loads(row)["row"])

    async def send_bytes(self, picture: bytes) -> None:
        self.pictures.append(picture)


def send(outbox: Outbox, page: Page) -> asyncio.Task[None]:
    return asyncio.create_task(outbox.send_to(page))  # type: ignore[arg-type]


async def until(condition: Callable[[], bool]) -> None:
    while not condition():
        await asyncio.sleep(0.001)


def tell(outbox: Outbox, count: int) -> None:
    for row in range(count):
        outbox.tell({"row": row})


def test_slow_page_delays_no_worker_and_receives_all_rows() -> None:
    async def run() -> list[int]:
        page, outbox = Page(is_released=False), Outbox()
        sending = send(outbox, page)
        await outbox.run(lambda: tell(outbox, 500))  # returns while the page is blocked
        assert not page.rows
        page.released.set()
        outbox.end()
        await sending
        return page.rows

    assert asyncio.run(run()) == list(range(500))


def test_page_that_accepts_no_rows_is_disconnected_after_a_limit() -> None:
    async def run() -> None:
        page, outbox = Page(), Outbox(max_unheard=5, max_waiting_bytes=1000)
        sending = send(outbox, page)
        await outbox.run(lambda: tell(outbox, 200))
        await sending

    with pytest.raises(BusyError, match="accepts rows too slowly"):
        asyncio.run(run())


def test_rows_and_pictures_wait_for_acknowledgements() -> None:
    async def run() -> None:
        page, outbox = Page(), Outbox(max_unheard=3)
        sending = send(outbox, page)
        tell(outbox, 5)
        await asyncio.sleep(0.01)
        assert page.rows == [0, 1, 2]
        outbox.acknowledge_rows(1)
        await asyncio.sleep(0.01)
        assert page.rows == [0, 1, 2, 3]
        outbox.acknowledge_rows(4)
        for number in range(4):
            outbox.show(lambda number=number: b"%d" % number)  # type: ignore[misc]
            await until(lambda number=number: len(page.pictures) >= min(number + 1, 2))  # type: ignore[misc]
        assert page.pictures == [b"0", b"1"]
        outbox.acknowledge_picture()
        await until(lambda: len(page.pictures) == 3)
        assert (page.pictures[2], page.rows) == (b"3", [0, 1, 2, 3, 4])  # the newest picture, and all rows
        outbox.end()
        await sending

    asyncio.run(run())


def test_worker_ends_when_the_page_disconnects() -> None:
    async def run() -> None:
        outbox = Outbox()
        outbox.close()
        with pytest.raises(GoneError):
            outbox.tell({"row": 0})
        await outbox.run(lambda: tell(outbox, 1))  # no error

    asyncio.run(run())


def test_error_of_a_worker_follows_its_last_row() -> None:
    async def run() -> list[int]:
        page, outbox = Page(), Outbox()

        def work() -> Any:
            tell(outbox, 3)
            raise BusyError("broken")

        await outbox.run(work)
        with pytest.raises(BusyError, match="broken"):
            await outbox.send_to(page)  # type: ignore[arg-type]
        return page.rows

    assert asyncio.run(run()) == [0, 1, 2]
