"""Recorded drive of page *Watch*, which also warms up the receiver."""

import contextlib
from pathlib import Path

from heliograph.base.errors import HeliographError
from heliograph.link.settings import LinkSettings
from heliograph.media import open_film
from heliograph.probe.screens import with_receiver_for
from heliograph.receive.api import make_receiver
from heliograph.signal.settings import SignalSettings

RECORDED_DRIVE = Path(__file__).with_name("recorded-drive.mp4")
"""Film of a drive from 80 m to 25 m, simulated by `scripts/make_drive.py`, with the truth."""


def warm_up() -> bool:
    """Receive the first packet: compiled functions load before a page needs them; return True on success."""
    signal = SignalSettings()
    with contextlib.suppress(HeliographError), open_film(RECORDED_DRIVE) as film:
        settings, _ = with_receiver_for(film, signal, LinkSettings())
        receiver = make_receiver(signal, settings.receive)
        for frame in film:
            if any(packet.has_codeword for packet in receiver.push(frame)):
                return True
    return False
