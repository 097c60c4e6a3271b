"""Values handed on from task to task, in this process and in another one."""

import pickle
from typing import cast

from heliograph.base.shared import Shared


class Count(Shared[int]):
    """Hands a number on."""

    kept = 2

    def __init__(self, name: str | None = None) -> None:
        super().__init__(0, name)


def elsewhere(one: Count) -> Count:
    """What another process gets, which stands for it in this one."""
    return cast(Count, pickle.loads(pickle.dumps(one)))


def test_another_process_has_a_content_of_its_own_that_stays() -> None:
    here = Count()
    here.keep(7)
    there = elsewhere(here)
    assert there.content == 0
    there.keep(3)
    assert elsewhere(here) is there
    assert (here.content, elsewhere(here).content) == (7, 3)


def test_another_process_keeps_those_asked_for_last() -> None:
    first, second, third = (Count() for _ in range(3))
    kept = [elsewhere(one) for one in (first, second, first, third)]
    assert elsewhere(first) is kept[0]
    assert elsewhere(second) is not kept[1]


def test_a_name_tells_one_from_another() -> None:
    one = Count("one")
    assert elsewhere(one) is elsewhere(Count("one"))
    assert elsewhere(one) is not elsewhere(Count("other"))
