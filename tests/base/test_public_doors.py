"""Invalid arguments of public functions raise a one-line HeliographError at the call."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import heliograph as h

SIGNAL = h.SignalSettings()
LINK = h.LinkSettings()


def written(path: Path, what: Any) -> None:
    with h.create_film(path / "a.h5", width=8, height=8, rate_hz=1000) as film:
        film.write(what)


def created(path: Path, **changes: Any) -> None:
    h.create_film(path / "a.mkv", **{"width": 64, "height": 64, "rate_hz": 1000, **changes})


def opened(path: Path, rate_hz: Any) -> None:
    h.open_film(path / "a.mkv", rate_hz=rate_hz)


Anything: Any = h
DOORS: dict[str, tuple[Callable[[Path], object], str]] = {
    "receive no signal": (lambda _: Anything.receive_frames([], None), "SignalSettings, not NoneType"),
    "receive a link": (lambda _: Anything.receive_frames([], LINK), "those of a link are .signal"),
    "receive by name": (lambda _: Anything.receive_frames([], SIGNAL, "soft"), "ReceiveSettings, not 'soft'"),
    "receive as a link": (lambda _: Anything.receive_frames([], SIGNAL, LINK), "those of a link are .receive"),
    "receive unobserved": (lambda _: Anything.receive_frames([], SIGNAL, None, 3), "takes an event, not 3"),
    "receive nothing": (lambda _: Anything.receive_frames(None, SIGNAL), "iterable of heliograph.Frame, not NoneType"),
    "make of nothing": (lambda _: Anything.make_receiver(None, None), "SignalSettings, not NoneType"),
    "own of nothing": (lambda _: Anything.own_settings(None), "ReceiveSettings, not NoneType"),
    "register nothing": (lambda _: Anything.register_receiver(None, int), "letters, digits, '-', '_' and '.'"),
    "register a number": (lambda _: Anything.register_receiver("mine", 3), "a function or a class, not by 3"),
    "a camera of a number": (lambda _: Anything.register_camera("mine", 3), "a function or a class, not by 3"),
    "a camera of no name": (lambda _: Anything.open_film("camera:"), "a camera is camera:KIND or camera:KIND:ADDRESS"),
    "a camera's wish": (lambda _: Anything.open_film("camera:aravis", camera={"gain": "x"}), "setting 'gain'"),
    "a wish of text": (lambda _: Anything.open_film("a.h5", camera="gain=3"), "settings of a camera are by name"),
    "a code of a number": (lambda _: Anything.register_code("mine", 3), "a function or a class, not by 3"),
    "open at no end": (lambda path: opened(path, 10**400), "1e-06 to 1e+06 frames/s, not"),
    "write an array": (lambda path: written(path, np.zeros((8, 8), np.uint8)), "heliograph.Frame, not ndarray"),
    "write nothing": (lambda path: written(path, None), "write Frame(index, time_s, pixels, bits)"),
    "metadata": (lambda path: created(path, metadata="x"), "metadata of a film is texts by name, got 'x'"),
    "a width of text": (lambda path: created(path, width="64"), "width of a film is a whole number, got '64'"),
    "bits": (lambda path: created(path, bits=None), "bits of a film is a whole number, got NoneType"),
    "a rate of text": (lambda path: created(path, rate_hz="fast"), "rate_hz of a film is a number, got 'fast'"),
    "a rate of digits": (lambda path: created(path, rate_hz=10**5000), "got a number of thousands of digits"),
    "a quality of text": (lambda path: created(path, codec="h264", crf="x"), "0 (best) and 51 (smallest), got 'x'"),
    "create nothing": (lambda _: Anything.create_film(None, width=8, height=8, rate_hz=1), "text or a pathlib.Path"),
    "open nothing": (lambda _: Anything.open_film(None), "text or a pathlib.Path, not NoneType"),
    "open no slots": (lambda _: Anything.open_slots(3), "the path of slots is text or a pathlib.Path, not 3"),
    "open at a word": (lambda path: opened(path, "x"), "1e-06 to 1e+06 frames/s, not 'x'"),
    "a budget of nothing": (lambda _: Anything.budget(None), "a budget is of heliograph.load_settings(...)"),
    "a budget in a light": (lambda _: Anything.budget(LINK, 3), "light is a heliograph.LightSettings, not 3"),
    "a light": (lambda _: Anything.LightSettings(candela=-1), "setting 'candela': input should be greater than"),
    "vary text": (lambda _: Anything.sweep("channel.distance_m=3"), "such as {"),
    "vary numbers": (lambda _: Anything.sweep({1: [2]}), "a key is text, such as 'channel.distance_m', not 1"),
    "set a number": (lambda _: Anything.sweep({}, set=3), "changes are values by key"),
    "as many as x": (lambda _: Anything.sweep({}, max_codewords="x"), "'max_codewords': input should be"),
    "as long as x": (lambda _: Anything.sweep({}, max_seconds="x"), "'max_seconds': input should be a valid number"),
    "workers of text": (lambda _: Anything.sweep({}, workers="2"), "workers are a whole number"),
    "a scheduler": (lambda _: Anything.sweep({}, workers=None, scheduler=3), "a scheduler is an address"),
    "output": (lambda _: Anything.sweep({}, output=3), "paths, not 3"),
    "load no preset": (lambda _: Anything.load_settings(None), "a preset is one of paper, "),
    "load text": (lambda _: Anything.load_settings("paper", "signal.side=8"), "changes are nested mappings"),
    "load items": (lambda _: Anything.load_settings("paper", {"channel": {"arrays": {7: {}}}}), "'7' is not an item"),
    "load letters": (lambda _: Anything.load_settings("paper", None, "signal.side=8"), "assignments are a list"),
    "send nothing": (lambda _: Anything.Transmitter(None, 0, {}), "SignalSettings, not NoneType"),
    "send as text": (lambda _: Anything.Transmitter(SIGNAL, 0, {}, ["single"]), "formats are a list of"),
    "plot nothing": (lambda _: Anything.plot_rates(None), "xarray.Dataset of heliograph.sweep, not NoneType"),
    "load no parts": (lambda _: Anything.load_parts(None), "the path of a Python file, not NoneType"),
    "simulate an array": (lambda _: Anything.simulate(np.zeros((3, 3)), [], 0), "load_settings(...), not ndarray"),
    "a side": (lambda _: Anything.SignalSettings(side=5), "setting 'side': input should be a multiple of 4, not 5"),
    "no key": (lambda _: Anything.SignalSettings(8), "settings are given by name, such as side=..., not 8 alone"),
}  # fmt: skip


@pytest.mark.parametrize(("call", "says"), DOORS.values(), ids=DOORS)
def test_public_functions_report_accepted_types(call: Callable[[Path], object], says: str, tmp_path: Path) -> None:
    with pytest.raises(h.HeliographError, match=re.escape(says)):  # at the call, before the first packet
        call(tmp_path)
    assert not list(tmp_path.iterdir())


def test_numbers_of_numpy_and_fractions_are_numbers(tmp_path: Path) -> None:
    metadata = {"a": "b"}
    with Anything.create_film(
        tmp_path / "a.h5", width=np.int64(8), height=np.uint8(8), rate_hz=np.float32(500), metadata=metadata
    ) as film:
        metadata["a"] = "later"
        film.write(h.Frame(0, 0.0, np.zeros((8, 8), np.uint8)))
    with Anything.open_film(tmp_path / "a.h5", rate_hz=np.float32(250)) as found:
        assert (found.claimed_hz, found.rate_hz, found.metadata) == (500, 250, {"a": "b"})
