"""The list of loops of a first use, and the process that compiles them ahead."""

import io
import os
import subprocess
import sys
from importlib import import_module
from types import SimpleNamespace

import pytest
from numba.core.registry import CPUDispatcher
from waiting import HANG_S

from heliograph.base import compile_ahead
from heliograph.base.compile_ahead import SWITCH, Loop, begins, compile_all, loops, types_of

LISTED = [loop for part in loops() for loop in part]


@pytest.mark.parametrize("loop", LISTED, ids=lambda loop: loop.name)
def test_the_list_is_of_loops_that_are_there(loop: Loop) -> None:
    # make it anew by `python scripts/make_first_use.py` where one was renamed or takes other arguments
    function = getattr(import_module(loop.module), loop.name)
    assert isinstance(function, CPUDispatcher)
    assert len(types_of(loop.signature)) == function.py_func.__code__.co_argcount


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of loops as they are compiled, of a list of two parts, a and b, c and d, of which c is no longer there."""
    names = [Loop(__name__, name, "(float64,)") for name in "abcd"]
    monkeypatch.setattr(compile_ahead, "loops", lambda: ((names[0], names[1]), (names[2], names[3])))
    done: list[str] = []
    for name in "abd":
        function = SimpleNamespace(compile=lambda _, name=name: done.append(name))
        monkeypatch.setattr(sys.modules[__name__], name, function, raising=False)
    return done


def test_loops_are_compiled_from_the_end_of_each_part(compiled: list[str]) -> None:
    assert [loop.name for loop in compile_all()] == compiled == ["b", "a", "d"]


def test_helpers_share_the_list_out(compiled: list[str]) -> None:
    assert [loop.name for loop in compile_all((), 0, 2)] == ["b", "d"]
    assert [loop.name for loop in compile_all((), 1, 2)] == ["a"]


def test_a_helper_leaves_out_what_its_parent_compiles(compiled: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    heard = SimpleNamespace(stdin=io.BytesIO())
    monkeypatch.setattr(compile_ahead, "_helpers", [heard])
    begins(__name__, "a", types_of("(float64,)"))
    begins(__name__, "d", types_of("(float32,)"))  # of other types it is another loop
    assert [loop.name for loop in compile_all(heard.stdin.getvalue().splitlines())] == ["b", "d"]


def test_helpers_are_started_once_and_for_what_is_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[list[str]] = []

    def start(command: list[str], **_: object) -> SimpleNamespace:
        started.append(command)
        return SimpleNamespace(stdin=io.BytesIO())

    monkeypatch.setattr(compile_ahead, "_helpers", [])
    monkeypatch.setattr(compile_ahead, "_cores", lambda: 3)
    monkeypatch.setattr(subprocess, "Popen", start)
    monkeypatch.setenv(SWITCH, "0")
    begins(*LISTED[0])
    assert not started
    monkeypatch.setenv(SWITCH, "1")
    begins("heliograph.elsewhere", "loop", "(float64,)")
    assert not started
    for loop in LISTED[:2]:
        begins(*loop)
    assert [command[-3:] for command in started] == [["heliograph.base.compile_ahead", n, "2"] for n in "01"]


def test_a_helper_that_has_ended_is_no_trouble(monkeypatch: pytest.MonkeyPatch) -> None:
    with subprocess.Popen([sys.executable, "-c", ""], stdin=subprocess.PIPE, bufsize=0) as helper:
        helper.wait(HANG_S)
        monkeypatch.setattr(compile_ahead, "_helpers", [helper])
        begins(*LISTED[0])


@pytest.mark.slow
def test_a_helper_with_nothing_left_ends_before_its_parent() -> None:
    command = [sys.executable, "-m", "heliograph.base.compile_ahead", "1000", "1001"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, env={**os.environ, SWITCH: "0"}) as helper:
        assert helper.wait(HANG_S) == 0


@pytest.mark.slow
def test_the_helper_ends_with_its_parent() -> None:
    command = [sys.executable, "-m", "heliograph.base.compile_ahead"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, env={**os.environ, SWITCH: "0"}) as helper:
        assert helper.stdin is not None
        helper.stdin.close()
        assert helper.wait(HANG_S) == 0
