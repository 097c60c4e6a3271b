"""Transmitters and channel together: messages to camera frames and their truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeGuard

import numpy as np

from heliograph.base.errors import SettingsError, shown
from heliograph.base.frames import Frame
from heliograph.channel import Footage, ImuTrace, Truth, film
from heliograph.link.settings import LinkSettings
from heliograph.transmit import Content, Transmitter

Messages = Mapping[str, Sequence[Content]]
"""Messages by layer: bytes, `Updates` that change, a `SentFile`."""


@dataclass(frozen=True, kw_only=True)
class Recordings:
    """Real recordings a simulation may use."""

    # Background, for channel.background.kind = "footage"; None where there is none
    footage: Footage | None = None
    # Motion of a car, for channel.shake = "imu"; None where there is none
    imu: ImuTrace | None = None


def default_messages(settings: LinkSettings) -> list[Messages]:
    """A text by layer for each array, which names the array and the layer."""
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
    """A transmitter for each array."""
    identities = settings.transmit.identities
    if isinstance(messages, Mapping) or not isinstance(messages, Sequence) or len(messages) != len(identities):
        raise SettingsError(
            f"messages are a list of what each array sends, one for each of the {len(identities)} in "
            f"transmit.identities, not {_counted(messages)}"
        )
    signal, formats = settings.signal, settings.transmit.formats
    return [Transmitter(signal, who, content, formats) for who, content in zip(identities, messages, strict=True)]


def _counted(messages: object) -> str:
    return f"{len(messages)}" if isinstance(messages, (list, tuple)) else f"a {type(messages).__name__}"


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

    Raises
    ------
    SettingsError
        The arguments are no settings, messages, seed or recordings, do not fit each other, or lack a recording.
    """
    _check(settings, seed, recordings, roi_margin_px)
    recordings = recordings or Recordings()
    return film(
        settings.channel,
        [sender.levels() for sender in transmitters(settings, messages)],
        np.random.default_rng(seed),
        pattern_period_s=settings.signal.pattern_period_s,
        slot_order=settings.signal.slot_order,
        steady=settings.signal.light == "steady",
        footage=recordings.footage,
        imu=recordings.imu,
        roi_margin_px=roi_margin_px,
    )


def _check(settings: object, seed: object, recordings: object, roi_margin_px: object) -> None:
    if not isinstance(settings, LinkSettings):
        raise SettingsError(f"settings are those of load_settings(...), not {shown(settings)}")
    if not (_is_whole(seed) and seed >= 0):
        raise SettingsError(f"a seed is a whole number, at least 0, not {shown(seed)}")
    if not isinstance(recordings, Recordings | None):
        raise SettingsError(f"recordings are heliograph.link.simulate.Recordings, not {type(recordings).__name__}")
    if roi_margin_px is not None and not _is_whole(roi_margin_px):
        raise SettingsError(f"roi_margin_px is a whole number of pixels, not {shown(roi_margin_px)}")


def _is_whole(value: object) -> TypeGuard[int]:
    return isinstance(value, (int, np.integer))
