"""Packet formats: numbers, words and signalling headers."""

from typing import Any

import numpy as np
import pytest

from heliograph.base.config import from_mapping, to_mapping
from heliograph.base.errors import SettingsError
from heliograph.signal.block import Block
from heliograph.signal.formats import AGREED, DIMMED, MODES, SIGNALLED_RATES, Format, format_of, words
from heliograph.signal.header import IDENTITIES, all_header_cells, header_levels, signalling_levels
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import RateSettings, SignalSettings

NUMBERS = range(512 * len(MODES))


def test_numbers_are_those_of_the_formats() -> None:
    assert [format_of(number).number for number in NUMBERS] == list(NUMBERS)
    assert format_of(0) == AGREED == Format()
    assert format_of(0o765) == Format(high=SIGNALLED_RATES[6], middle=SIGNALLED_RATES[5], low=SIGNALLED_RATES[4])
    for number in (-1, len(NUMBERS)):
        with pytest.raises(ValueError, match=f"not {number}"):
            format_of(number)


def test_words_are_apart_and_the_first_is_empty() -> None:
    found = words()
    assert found.shape == (len(NUMBERS), 16)
    assert not found[0].any()
    apart = (found[:, None] ^ found[None]).sum(-1)
    assert apart[~np.eye(len(found), dtype=bool)].min() == 4
    # linear code: the sum of two words is a word
    assert np.array_equal(found[0o700] ^ found[0o065], found[0o765])


def test_format_0_leaves_the_header_as_it_is() -> None:
    for identity in range(IDENTITIES):
        assert np.array_equal(signalling_levels(identity, 0), header_levels(identity))


def test_dimmed_cells_keep_their_sign() -> None:
    for number in NUMBERS[1::50]:
        levels, full = signalling_levels(7, number, 8).astype(int) - 2, header_levels(7, 8).astype(int) - 2
        contrasts = np.where(words()[number], DIMMED, 1.0).reshape(4, 4)
        assert np.array_equal(levels, full * np.kron(contrasts, np.ones((2, 2))))
        assert set(np.unique(np.abs(levels))) <= {1, 2}


def test_a_detector_of_the_plain_header_finds_all() -> None:
    """The sum over both pairs, as a four-frame detector combines them, correlates above 0.989 with the header."""
    cells = all_header_cells().reshape(IDENTITIES, 1, 16).astype(float)
    shown = cells * (1 + np.where(words(), 0.5, 1.0))
    own = (shown * cells).sum(-1) / np.linalg.norm(shown, axis=-1) / 4
    assert own.min() > 0.989
    others = (
        np.abs(shown @ all_header_cells().reshape(IDENTITIES, 16).T) / np.linalg.norm(shown, axis=-1)[..., None] / 4
    )
    others[np.arange(IDENTITIES), :, np.arange(IDENTITIES)] = 0
    assert others.max() < 0.75


def test_rates_named_and_agreed() -> None:
    settings = SignalSettings(rate=RateSettings(high=0.4, middle=1 / 3, low=0.55))
    form = PacketFormat(settings, Format(middle=0.75))
    codes = [layer.code for layer in form.layers.values()]
    assert [round(code.k / code.length, 2) for code in codes] == [0.40, 0.75, 0.55]


def test_first_pair_never_names() -> None:
    form = PacketFormat(SignalSettings(side=8, header_pairs=3, data_pairs=21), Format(high=0.9))
    idle = {name: [Block(name, 4, 0, 0, 0, b"")] * layer.codewords for name, layer in form.layers.items()}
    patterns = form.patterns(4, idle)
    number = Format(high=0.9).number
    assert np.array_equal(patterns[0], header_levels(4, 8))
    assert np.array_equal(patterns[2], signalling_levels(4, number, 8))
    assert np.array_equal(patterns[4], patterns[2])
    assert not np.array_equal(patterns[0], patterns[2])
    assert np.all(patterns[0::2] + patterns[1::2] == 4)


@pytest.mark.parametrize("text", ["2/3", 0.667, 2 / 3])
def test_rates_may_be_fractions(text: Any) -> None:
    named = from_mapping(Format, {"high": text})
    assert named.high == 2 / 3
    assert from_mapping(Format, to_mapping(named)) == named


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"high": 0.7}, "setting 'high': a header can name the rates 2/5, 1/2, 3/5, 2/3, 3/4, 5/6 and 9/10, not 0.7"),
        ({"mode": "triple"}, "setting 'mode'"),
        ({"hihg": 0.5}, "did you mean 'high'"),
    ],
)
def test_refusals(change: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError) as error:
        from_mapping(Format, change)
    assert message in str(error.value)


@pytest.mark.parametrize("change", [{"header_pairs": 1}, {"header": "all_on"}])
def test_a_format_needs_a_second_header_pair(change: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match=r"set signal\.header_pairs to 2 or more"):
        PacketFormat(SignalSettings(**change), Format(high=0.5))
    PacketFormat(SignalSettings(**change), AGREED)
