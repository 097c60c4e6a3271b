"""What a film notes of its signal and of its truth, and whether both fit what they are read with."""

import json
from collections.abc import Mapping, Sequence
from typing import Any

from heliograph.base.config import from_mapping, keys_of, merge, to_mapping
from heliograph.base.errors import MediaError, brief
from heliograph.link.truth import TruthFile
from heliograph.media import FilmReader
from heliograph.signal.settings import SignalSettings

SIGNAL_TAG = "heliograph_signal"
"""Metadata of a film that holds its signal's settings; a receiver may know them."""

TRUTH_TAG = "heliograph_simulation"
"""Metadata of a simulated film that names its truth file: a random id both have."""

RATE_TOLERANCE = 1e-3
"""Relative departure of a film's rate from its truth's that a container's rounding explains."""


def signal_note(signal: SignalSettings) -> dict[str, str]:
    """Return what a film notes of its signal, as metadata."""
    return {SIGNAL_TAG: json.dumps(to_mapping(signal))}


def noted_signal(film: FilmReader) -> dict[str, Any]:
    """Signal settings that a film notes, as nested mappings; empty where it notes none."""
    text = film.metadata.get(SIGNAL_TAG)
    if text is None:
        return {}
    try:
        note = json.loads(text)
        from_mapping(SignalSettings, note)
    except (ValueError, RecursionError) as error:  # no JSON, or no settings
        raise MediaError(
            f"the film's note on its signal is unreadable ({brief(error)}); set signal.* yourself"
        ) from None
    return dict(note)


def signal_of(
    film: FilmReader, preset: SignalSettings, changes: Sequence[Mapping[str, Any]] = ()
) -> tuple[SignalSettings, str]:
    """Signal of a film: the preset's, changed by the film's note and then by the changes."""
    try:
        note = noted_signal(film)
    except MediaError:
        if not any(changes):
            raise
        note = {}
    noted = merge(to_mapping(preset), note)
    tree = noted
    for change in changes:
        tree = merge(tree, change)
    signal = from_mapping(SignalSettings, tree)
    departures = _differences(signal, from_mapping(SignalSettings, noted)) if note else []
    listed = ", ".join(f"{key}={ours} instead of {theirs}" for key, ours, theirs in departures)
    return signal, f"not as the film's note says: {listed}" if listed else ""


def departures(film: object, signal: SignalSettings) -> list[tuple[str, Any, Any]]:
    """Return the settings in which a signal differs from what a film notes: dotted key, value, noted value."""
    try:
        note = json.loads(getattr(film, "metadata", {}).get(SIGNAL_TAG, "{}"))
        return _differences(signal, from_mapping(SignalSettings, merge(to_mapping(signal), note)))
    except (ValueError, RecursionError):  # no JSON, or no settings
        return []


def _differences(one: SignalSettings, other: SignalSettings) -> list[tuple[str, Any, Any]]:
    """Dotted keys in which two signals differ, with both values."""
    pairs = [(key, _value(one, key), _value(other, key)) for key in keys_of(SignalSettings)]
    return [(f"signal.{key}", _shown(a), _shown(b)) for key, a, b in pairs if a != b]


def _value(settings: Any, key: str) -> Any:
    for part in key.split("."):
        settings = getattr(settings, part)
    return settings


def _shown(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value


def check_truth(film: FilmReader, truth: TruthFile, signal: SignalSettings) -> None:
    """Check that errors can be counted: the truth is that of the film, and the signal is the one that was sent."""
    camera, own = truth.settings.channel.camera, film.metadata.get(TRUTH_TAG)
    size, rate = (camera.width, camera.height), camera.fps
    if own and truth.film_id and own != truth.film_id:
        differs = "they come from different simulations"
    elif size != (film.width, film.height):
        differs = f"it has frames of {size[0]}x{size[1]} pixels, the film of {film.width}x{film.height}"
    elif abs(rate / film.rate_hz - 1) > RATE_TOLERANCE:
        differs = f"it has {rate:g} frames/s, the film {film.rate_hz:g}"
    elif departures := _differences(signal, truth.settings.signal):
        key, ours, sent = departures[0]
        raise MediaError(
            f"{key} is {ours}, but {truth.path} says {sent} was sent: errors cannot be counted; "
            f"leave signal.* as the film notes it, or give no truth"
        )
    else:
        return
    raise MediaError(f"{truth.path} is not the truth of {film.path}: {differs}; give the one written beside the film")
