"""Receivers in several threads."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest
from scenes import film, link
from threadpoolctl import threadpool_info, threadpool_limits

from heliograph.base.threads import in_one_thread, one_thread
from heliograph.receive import Packet, receive_frames


def blas_threads() -> int:
    """Return the largest thread count; some BLAS builds are single-threaded."""
    return max(int(info["num_threads"]) for info in threadpool_info() if info["user_api"] == "blas")


@pytest.fixture
def two_threads() -> Iterator[None]:
    with threadpool_limits(limits=2, user_api="blas"):
        yield


@pytest.mark.usefixtures("two_threads")
def test_who_leaves_first_takes_no_thread_from_those_that_stay() -> None:
    """Blocks in different threads may end in any order."""
    first, second = one_thread(), one_thread()
    with first:
        second.__enter__()
        assert blas_threads() == 1
    assert blas_threads() == 1, "the second is still at work"
    second.__exit__(None, None, None)
    assert blas_threads() == 2, "BLAS has what it had before"


@pytest.mark.usefixtures("two_threads")
def test_blas_is_given_back_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), one_thread():
        _ = 1 / 0
    assert blas_threads() == 2


def content(packet: Packet) -> list[Any]:
    words = [(layer, w.status, w.bits.tobytes(), w.raw.tobytes()) for layer, by in packet.layers.items() for w in by]
    return [packet.identity, packet.status, packet.first_frame, packet.last_frame, packet.pose, words]


@pytest.mark.usefixtures("two_threads")
@pytest.mark.slow
def test_four_receivers_in_four_threads_read_what_one_after_the_other_reads() -> None:
    """Two plain and two soft receivers with separate films."""
    settings = [link(f"receive.receiver={name}", "signal.data_pairs=16") for name in ("plain", "soft") * 2]
    films = [film(one, 100, seed) for seed, one in enumerate(settings)]

    def read(number: int) -> list[list[Any]]:
        one = settings[number]
        return [content(packet) for packet in receive_frames(films[number], one.signal, one.receive)]

    alone = [read(number) for number in range(4)]
    assert all(len(packets) >= 2 for packets in alone)
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(read, range(4))) == alone
    assert blas_threads() == 2


def test_ctrl_c_amid_machine_code_is_ctrl_c() -> None:
    """In compiled code, KeyboardInterrupt appears as the cause of a (possibly nested) SystemError."""

    def interrupted() -> Iterator[int]:
        yield 1
        try:
            raise SystemError("amid it") from KeyboardInterrupt()
        except SystemError as error:
            raise SystemError("around it") from error

    items = in_one_thread(interrupted)()
    assert next(items) == 1
    with pytest.raises(KeyboardInterrupt):
        next(items)


def test_other_system_errors_stay_what_they_are() -> None:
    def broken() -> Iterator[int]:
        raise SystemError("broken")
        yield 1

    with pytest.raises(SystemError, match="broken"):
        next(in_one_thread(broken)())
