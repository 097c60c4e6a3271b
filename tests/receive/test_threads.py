"""Receivers in several threads."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest
from scenes import comparable, film, link, received
from threadpoolctl import threadpool_info, threadpool_limits

from heliograph.base.threads import in_one_thread, one_thread
from heliograph.receive import Packet


def blas_threads() -> int:
    """Return the largest thread count; some BLAS builds are single-threaded."""
    return max(int(info["num_threads"]) for info in threadpool_info() if info["user_api"] == "blas")


@pytest.fixture
def two_threads() -> Iterator[None]:
    with threadpool_limits(limits=2, user_api="blas"):
        yield


@pytest.mark.usefixtures("two_threads")
def test_overlapping_limits_end_in_any_order() -> None:
    """Blocks in different threads may end in any order."""
    first, second = one_thread(), one_thread()
    with first:
        second.__enter__()
        assert blas_threads() == 1
    assert blas_threads() == 1, "the second is still at work"
    second.__exit__(None, None, None)
    assert blas_threads() == 2, "BLAS has what it had before"


@pytest.mark.usefixtures("two_threads")
def test_limit_ends_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), one_thread():
        _ = 1 / 0
    assert blas_threads() == 2


@pytest.mark.usefixtures("two_threads")
@pytest.mark.slow
def test_receivers_in_four_threads_read_the_same_as_in_sequence() -> None:
    """Two plain and two soft receivers with separate films."""
    settings = [link(f"receive.receiver={name}", "signal.data_pairs=16") for name in ("plain", "soft") * 2]
    films = [film(one, 40, seed, roi_margin_px=20) for seed, one in enumerate(settings)]

    def read(number: int) -> list[Packet]:
        return comparable(received(films[number], settings[number]))

    sequential = [read(number) for number in range(4)]
    assert all(sequential)
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(read, range(4))) == sequential
    assert blas_threads() == 2


def test_ctrl_c_in_compiled_code_raises_keyboard_interrupt() -> None:
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


def test_other_system_errors_are_unchanged() -> None:
    def broken() -> Iterator[int]:
        raise SystemError("broken")
        yield 1

    with pytest.raises(SystemError, match="broken"):
        next(in_one_thread(broken)())
