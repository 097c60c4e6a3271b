"""Arbitrary text, such as a file name, prints on a single line."""

import pickle

import pytest

from heliograph.base.errors import HeliographError, MediaError, printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("drive 2.h5", "drive 2.h5"),
        ("試験-سلام-\N{GRINNING FACE}", "試験-سلام-\N{GRINNING FACE}"),
        ("می\u200cخواهم \N{WOMAN}\u200d\N{MICROSCOPE}\u3000", "می\u200cخواهم \N{WOMAN}\u200d\N{MICROSCOPE}\u3000"),
        ("caf\udce9.h5", r"caf\xe9.h5"),
        ("a\nb\tc\rd", r"a\nb\tc\rd"),
        ("\x1b[31mred\x7f", r"\x1b[31mred\x7f"),
        ("a\u2028b\u0085c", r"a\u2028b\x85c"),
        ("\u202egpj.exe", r"\u202egpj.exe"),
        ("\ud800", r"\ud800"),
        (r"C:\new\table", r"C:\new\table"),
    ],
)
def test_what_a_terminal_cannot_show_is_escaped(text: str, shown: str) -> None:
    assert printable(text) == shown
    assert printable(shown) == shown
    shown.encode()


@pytest.mark.parametrize("kind", [HeliographError, MediaError])
def test_a_message_is_one_line_whatever_it_names(kind: type[HeliographError]) -> None:
    error = kind("cannot read caf\udce9\n\x1b[2J.h5")
    assert str(error) == r"cannot read caf\xe9\n\x1b[2J.h5"
    assert str(pickle.loads(pickle.dumps(error))) == str(error)
