"""Packet formats: numbers, words and signalling headers."""

from dataclasses import asdict
from typing import Any

import numpy as np
import pytest

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.signal.formats import AGREED, MODES, SIGNALLED_RATES, Format, format_of, words
from heliograph.signal.header import IDENTITIES, all_header_cells
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

NUMBERS = range(512 * len(MODES))


def test_numbers_are_those_of_the_formats() -> None:
    assert [format_of(number).number for number in NUMBERS] == list(NUMBERS)
    assert format_of(0) == AGREED == Format()
    assert format_of(0o765) == Format(high=SIGNALLED_RATES[6], middle=SIGNALLED_RATES[5], low=SIGNALLED_RATES[4])


def test_words_are_apart_and_the_first_is_empty() -> None:
    found = words()
    assert found.shape == (len(NUMBERS), 16)
    assert not found[0].any()
    apart = (found[:, None] ^ found[None]).sum(-1)
    assert apart[~np.eye(len(found), dtype=bool)].min() == 4
    assert np.array_equal(found[0o700] ^ found[0o065], found[0o765])  # linear code: the sum of two words is a word


def test_a_detector_of_the_plain_header_finds_all() -> None:
    """The sum over both pairs, as a four-frame detector combines them, correlates above 0.989 with the header."""
    cells = all_header_cells().reshape(IDENTITIES, 1, 16).astype(float)
    shown = cells * (1 + np.where(words(), 0.5, 1.0))
    own = (shown * cells).sum(-1) / np.linalg.norm(shown, axis=-1) / 4
    assert own.min() > 0.989
    others = np.abs(shown @ cells[:, 0].T) / np.linalg.norm(shown, axis=-1)[..., None] / 4
    others[np.arange(IDENTITIES), :, np.arange(IDENTITIES)] = 0
    assert others.max() < 0.75


@pytest.mark.parametrize("text", ["2/3", 0.667, 2 / 3])
def test_rates_may_be_fractions(text: Any) -> None:
    named = from_mapping(Format, {"high": text})
    assert (named.high, from_mapping(Format, asdict(named))) == (2 / 3, named)


@pytest.mark.parametrize(("change", "message"), [
    ({"high": 0.7}, "setting 'high': a header can name the rates 2/5, 1/2, 3/5, 2/3, 3/4, 5/6 and 9/10, not 0.7"),
    ({"mode": "triple"}, "setting 'mode'"), ({"hihg": 0.5}, "did you mean 'high'"),
])  # fmt: skip
def test_refusals(change: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError) as error:
        from_mapping(Format, change)
    assert message in str(error.value)


@pytest.mark.parametrize("change", [{"header_pairs": 1}, {"header": "all_on"}])
def test_a_format_needs_a_second_header_pair(change: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=r"set signal\.header_pairs to 2 or more"):
        PacketFormat(SignalSettings(**change), Format(high=0.5))
    PacketFormat(SignalSettings(**change), AGREED)
