"""Transmitters and channel together: messages to camera frames and their truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.base.errors import HeliographError, SettingsError
from heliograph.base.frames import Frame
from heliograph.channel import Footage, ImuTrace, Truth, film
from heliograph.link.settings import LinkSettings
from heliograph.transmit import Transmitter

Messages = Mapping[str, Sequence[bytes]]
"""Messages by layer."""


@dataclass(frozen=True, kw_only=True)
class Recordings:
    """Real recordings a simulation may use.

    Attributes
    ----------
    footage
        Background, for channel.background.kind = "footage"; None where there is none.
    imu
        Motion of a car, for channel.shake = "imu"; None where there is none.
    """

    footage: Footage | None = None
    imu: ImuTrace | None = None


def default_messages(settings: LinkSettings) -> list[Messages]:
    """A text by layer for each array, which names the array and the layer.

    Parameters
    ----------
    settings
        The link, of which ``transmit.identities`` is used.
    """
    rules = {
        "high": "Signal ahead: red for 12 s. Prepare to stop.",
        "middle": "Junction 7: right lane closed, detour by Harbour Road, 4 minutes of delay.",
        "low": "Map of the junction, timetable of the tram, weather and parking follow with this array's data.",
    }
    return [
        {layer: [f"Array {identity}, {layer} priority. {text} ".encode() * 8] for layer, text in rules.items()}
        for identity in settings.transmit.identities
    ]


def transmitters(settings: LinkSettings, messages: Sequence[Messages]) -> list[Transmitter]:
    """A transmitter for each array.

    Parameters
    ----------
    settings
        The link; its `signal` and `transmit` parts are used.
    messages
        What each array sends, in the order of the arrays.

    Raises
    ------
    SettingsError
        A message is too long, there are too many, or a packet is too small for a codeword.
    """
    pairs = zip(settings.transmit.identities, messages, strict=True)
    return [_transmitter(settings, identity, content) for identity, content in pairs]


def _transmitter(settings: LinkSettings, identity: int, messages: Messages) -> Transmitter:
    try:
        return Transmitter(settings.signal, identity, messages, settings.transmit.formats)
    except HeliographError:
        raise
    except ValueError as error:
        raise SettingsError(f"array {identity}: {error}; send less, or cut it up") from None


def simulate(
    settings: LinkSettings,
    messages: Sequence[Messages],
    seed: int,
    recordings: Recordings | None = None,
    roi_margin_px: int | None = None,
) -> Iterator[tuple[Frame, Truth]]:
    """Film of a drive past the arrays.

    Parameters
    ----------
    settings
        The link; its `receive` part is not looked at.
    messages
        What each array sends, in the order of the arrays.
    seed
        Of road, scene and noise, at least 0.
    recordings
        Real background and motion; None where there are none.
    roi_margin_px
        None for whole frames; else only the arrays' surroundings, this many px wider than they.
    """
    recordings = recordings or Recordings()
    return film(
        settings.channel,
        [sender.levels() for sender in transmitters(settings, messages)],
        np.random.default_rng(seed),
        pattern_period_s=settings.signal.pattern_period_s,
        slot_order=settings.signal.slot_order,
        footage=recordings.footage,
        imu=recordings.imu,
        roi_margin_px=roi_margin_px,
    )
