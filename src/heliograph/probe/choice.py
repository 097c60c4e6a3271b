"""Choice of the receiver for a film."""

from dataclasses import replace
from itertools import islice

from heliograph.link.settings import LinkSettings
from heliograph.media import FilmReader
from heliograph.media.live.reader import live_of
from heliograph.probe.screens import screen_cause
from heliograph.receive.api import choose_receiver
from heliograph.signal.settings import SignalSettings


def with_receiver_for(film: FilmReader, signal: SignalSettings, link: LinkSettings) -> tuple[LinkSettings, str]:
    """Return settings with the receiver for a film, and a line on the choice."""
    name, reason = choose_receiver(signal, film.rate_hz)
    frames = [] if live_of(film) is not None or film.rate_hz > 250 else list(islice(film, 96))
    screen = screen_cause(frames, film.rate_hz) if frames else None
    if screen is not None:
        name, reason = "screen", screen.why
    elif name == "screen":
        # a film in slow motion may state another rate, which "plain" reports
        name = "plain"
    return replace(link, receive=replace(link.receive, receiver=name)), f"receiver {name}: {reason}"
