"""The list of loops of a first use, and the process that compiles them ahead."""

import os
import subprocess
import sys
from importlib import import_module
from types import SimpleNamespace

import pytest
from numba.core.registry import CPUDispatcher

from heliograph.base import compile_ahead
from heliograph.base.compile_ahead import SWITCH, Loop, compile_all, loops, start_once, types_of

LISTED = [loop for part in loops() for loop in part]


@pytest.mark.parametrize("loop", LISTED, ids=lambda loop: loop.name)
def test_the_list_is_of_loops_that_are_there(loop: Loop) -> None:
    # make it anew by `python scripts/make_first_use.py` where one was renamed or takes other arguments
    function = getattr(import_module(loop.module), loop.name)
    assert isinstance(function, CPUDispatcher)
    assert len(types_of(loop.signature)) == function.py_func.__code__.co_argcount


def test_loops_are_compiled_from_the_end_of_each_part(monkeypatch: pytest.MonkeyPatch) -> None:
    names = [Loop(__name__, name, "(float64,)") for name in "abcd"]
    monkeypatch.setattr(compile_ahead, "loops", lambda: ((names[0], names[1]), (names[2], names[3])))
    compiled: list[str] = []
    for name in "abd":  # c is no longer there
        function = SimpleNamespace(compile=lambda _, name=name: compiled.append(name))
        monkeypatch.setattr(sys.modules[__name__], name, function, raising=False)
    assert [loop.name for loop in compile_all()] == compiled == ["b", "a", "d"]


def test_a_helper_is_started_once_and_for_what_is_listed(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[list[str]] = []
    monkeypatch.setattr(compile_ahead, "_helpers", [])
    monkeypatch.setattr(compile_ahead, "_cores", lambda: 2)
    monkeypatch.setattr(subprocess, "Popen", lambda command, **_: started.append(command))
    monkeypatch.setenv(SWITCH, "0")
    start_once(*LISTED[0][:2])
    assert not started
    monkeypatch.setenv(SWITCH, "1")
    start_once("heliograph.elsewhere", "loop")
    assert not started
    for loop in LISTED[:2]:
        start_once(*loop[:2])
    assert [command[-1] for command in started] == ["heliograph.base.compile_ahead"]


@pytest.mark.slow
def test_the_helper_ends_with_its_parent() -> None:
    command = [sys.executable, "-m", "heliograph.base.compile_ahead"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, env={**os.environ, SWITCH: "0"}) as helper:
        assert helper.stdin is not None
        helper.stdin.close()
        assert helper.wait(60) == 0
