"""User errors raise a one-line HeliographError; an unknown luminance is an erasure."""

from typing import Any

import numpy as np
import pytest

from heliograph import decode, encode, load_settings, simulate
from heliograph.base.errors import HeliographError
from heliograph.link.settings import LinkSettings

GOOD = [{"high": [b"kept"]}]


@pytest.mark.parametrize(("arguments", "says"), [
    (({"hi": b"a"},), "layers are high, middle, low, not hi"),
    (({"high": "text"},), "a message of the high layer is bytes, not str"),
    ((b"a",), "bytes by layer"), (({"high": b"a"}, 77), "0 to 29, not 77"),
    (({"high": b"a"}, 1.0), "0 to 29, not 1.0"), (({"high": bytes(1 << 24)},), "send less, or cut it up"),
    (({"high": b"a"}, 0, {"side": 8}), "SignalSettings, not dict"),
    (({"high": b"a"}, 0, LinkSettings()), "those of a link are .signal"),
])  # fmt: skip
def test_encode_reports_wrong_arguments(arguments: tuple[Any, ...], says: str) -> None:
    with pytest.raises(HeliographError, match=says):
        encode(*arguments)


@pytest.mark.parametrize(("luminances", "says"), [
    (None, r"whole packets of 100, not \(\)"),
    (np.zeros((5, 16, 16)), r"whole packets of 100, not \(5, 16, 16\)"),
    ("abc", "real numbers"), ([[1], [2, 3]], "real numbers"), (np.zeros((100, 16, 16), complex), "real numbers"),
])  # fmt: skip
def test_decode_reports_wrong_arguments_immediately(luminances: Any, says: str) -> None:
    with pytest.raises(HeliographError, match=says):
        decode(luminances)  # raises before the first message is requested


@pytest.mark.parametrize("hidden", [
    np.s_[10, 3, 3], np.s_[10:20], np.s_[:2], np.s_[:, 4:9, 3:9], np.s_[::2, 5], np.s_[50],
])  # fmt: skip
@pytest.mark.parametrize("unknown", [np.nan, np.inf, -np.inf])
def test_a_luminance_that_is_not_known_is_an_erasure(hidden: Any, unknown: float) -> None:
    x = encode({"high": b"kept"}, 7).astype(float)
    x[hidden] = unknown
    assert [(one.identity, one.data) for one in decode(x)] == [(7, b"kept")]


@pytest.mark.parametrize("fault", [1e308, -1e308, 1e8])
@pytest.mark.parametrize("unit", [1.0, 1e200, 1e-200])
@pytest.mark.parametrize("hidden", [np.s_[::5, 3, 3], np.s_[7, 3, 3], np.s_[:, 4:9, 3:9]])
def test_a_luminance_absurdly_beyond_the_others_is_an_erasure(fault: float, unit: float, hidden: Any) -> None:
    x = encode({"high": b"kept"}, 7) * unit
    x[hidden] = fault * min(unit, 1) if abs(fault) > 1e300 else fault * unit
    assert [(one.identity, one.data) for one in decode(x)] == [(7, b"kept")]


def test_empty_luminances_decode_to_nothing() -> None:
    assert not list(decode(np.full((100, 16, 16), np.nan)))
    assert not list(decode(np.zeros((100, 16, 16))))


@pytest.mark.parametrize(("changes", "says"), [
    ({"settings": "static"}, "load_settings"),
    ({"messages": []}, "one entry for each of the 1 in transmit.identities, not 0"),
    ({"messages": GOOD * 2}, "not 2"), ({"messages": {"high": [b"a"]}}, "not a dict"),
    ({"messages": [{"high": ["a"]}]}, "bytes, not str"),
    ({"messages": [{"high": b"abc"}]}, "has a list of messages, not bytes"),
    ({"messages": [{"hi": [b"abc"]}]}, "layers are"), ({"messages": [[b"abc"]]}, "lists of bytes by layer"),
    ({"seed": -1}, "whole number, at least 0, not -1"), ({"seed": None}, "not None"), ({"seed": 1.5}, "not 1.5"),
    ({"recordings": 3}, "Recordings, not int"), ({"roi_margin_px": "a"}, "whole number of pixels"),
    ({"roi_margin_px": -1}, "at least 0, not -1"),
])  # fmt: skip
def test_simulate_reports_wrong_arguments(changes: dict[str, Any], says: str) -> None:
    given = {"settings": load_settings("static"), "messages": GOOD, "seed": 0, **changes}
    with pytest.raises(HeliographError, match=says):
        simulate(**given)
