"""Transmitters and channel together: messages to camera frames and their truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError, SettingsError, shown
from heliograph.base.frames import Frame
from heliograph.channel.background import Footage
from heliograph.channel.camera import film
from heliograph.channel.motion import ImuTrace
from heliograph.channel.truth import Truth
from heliograph.link.settings import LinkSettings
from heliograph.link.tables import read_columns
from heliograph.media import open_film
from heliograph.transmit import Messages, Transmitter

IMU_COLUMNS = ("t_s", "gyro_fwd_rad_s", "gyro_right", "gyro_down", "speed_m_s")
"""Columns of a motion file: time, rates about the forward, right and down axes, car speed."""


def load_footage(path: Path) -> Footage:
    """Load footage from a video file; each pass reads the file from the start."""
    with open_film(path, expand_range=True) as film:
        rate = film.rate_hz
        next(iter(film))

    def frames() -> Iterator[NDArray[np.uint8]]:
        with open_film(path, expand_range=True) as film:
            for frame in film:
                yield (frame.pixels >> (frame.bits - 8)).astype(np.uint8)

    return Footage(frames, rate)


def load_imu(path: Path) -> ImuTrace:
    """Load vehicle motion from a CSV file."""
    try:
        return ImuTrace.from_columns(*read_columns(path, IMU_COLUMNS))
    except ValueError as error:
        raise MediaError(f"{path}: {error}") from None


@dataclass(frozen=True, kw_only=True)
class Recordings:
    """Recordings for a simulation."""

    # Background for channel.background.kind = "footage"
    footage: Footage | None = None
    # Vehicle motion for channel.shake = "imu"
    imu: ImuTrace | None = None


DEFAULT_TEXTS = {
    "high": "Signal ahead: red for 12 s. Prepare to stop.",
    "middle": "Junction 7: right lane closed, detour by Harbour Road, 4 minutes of delay.",
    "low": "Map of the junction, timetable of the tram, weather and parking follow with this array's data.",
}
"""Texts by layer, each of a codeword."""


def default_messages(settings: LinkSettings) -> list[Messages]:
    """Return a long text for each array and layer."""
    return [
        {layer: [f"Array {who}, {layer} priority. {text} ".encode() * 8] for layer, text in DEFAULT_TEXTS.items()}
        for who in settings.transmit.identities
    ]


def transmitters(settings: LinkSettings, messages: Sequence[Messages]) -> list[Transmitter]:
    """Return a transmitter for each array."""
    identities = settings.transmit.identities
    if isinstance(messages, Mapping) or not isinstance(messages, Sequence) or len(messages) != len(identities):
        given = len(messages) if isinstance(messages, (list, tuple)) else f"a {type(messages).__name__}"
        raise SettingsError(
            f"messages are a list, one entry for each of the {len(identities)} in transmit.identities, not {given}"
        )
    signal, formats = settings.signal, settings.transmit.formats
    return [Transmitter(signal, who, content, formats) for who, content in zip(identities, messages, strict=True)]


def simulate(
    settings: LinkSettings,
    messages: Sequence[Messages],
    seed: int,
    recordings: Recordings | None = None,
    roi_margin_px: int | None = None,
) -> Iterator[tuple[Frame, Truth]]:
    """Simulate a film of a drive past the arrays.

    Parameters
    ----------
    settings
        Link settings; `receive` is ignored.
    messages
        Messages of each array, in the order of the arrays.
    seed
        Seed of road, scene and noise, at least 0.
    recordings
        Recorded background and motion.
    roi_margin_px
        Margin in px around the arrays to render; None for full frames.

    Raises
    ------
    SettingsError
        The arguments are no settings, messages, seed or recordings, do not fit each other, or lack a recording.
    """
    if not isinstance(settings, LinkSettings):
        raise SettingsError(f"settings are the result of load_settings(...), not {shown(settings)}")
    if not (isinstance(seed, (int, np.integer)) and seed >= 0):
        raise SettingsError(f"a seed is a whole number, at least 0, not {shown(seed)}")
    if not isinstance(recordings, Recordings | None):
        raise SettingsError(f"recordings are heliograph.link.simulate.Recordings, not {type(recordings).__name__}")
    if not isinstance(roi_margin_px, int | np.integer | None):
        raise SettingsError(f"roi_margin_px is a whole number of pixels, not {shown(roi_margin_px)}")
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
