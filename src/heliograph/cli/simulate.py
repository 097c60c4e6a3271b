"""heliograph simulate."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.base.errors import SettingsError
from heliograph.base.words import counted
from heliograph.cli import console, options

LARGE_BYTES, BYTES_PER_PIXEL = 2e8, 0.35
"""Size of a film from which on it is told beforehand, chosen; bytes of a pixel of the paper's drive without loss."""

if TYPE_CHECKING:
    from heliograph.link.settings import LinkSettings
    from heliograph.link.simulate import Recordings


def run_simulate(
    film: Path,
    preset: str,
    file: Path | None,
    assignments: list[str] | None,
    seed: int,
    background: Path | None,
    imu: Path | None,
    sent: options.Sent,
    codec: dict[str, Any],
) -> None:
    """Simulate a drive into a film."""
    from heliograph.link.film import frames_of, sent_s, write_film
    from heliograph.link.truth import truth_path

    for written_file in (film, truth_path(film)):
        options.refuse_to_replace(written_file, (*sent.inputs, background, imu, file))
    settings, recordings = scene_from(preset, file, assignments, background, imu)
    messages = options.read_messages(settings, sent, sent_s(settings))
    _announce(film, settings, codec)
    written = 0
    try:
        with console.progress("simulating", frames_of(settings)) as advance:

            def note(frames: int) -> None:
                nonlocal written
                written = frames
                advance(frames)

            count = write_film(film, settings, messages, seed, recordings, note, **codec)
    except KeyboardInterrupt:
        kept = f"{film} holds the {counted(written, 'frame')} so far" if written else "nothing was written"
        console.complain(f"interrupted; {kept}")
        sys.exit(console.INTERRUPTED)
    console.say(f"{film}: {counted(count, 'frame')}; truth in {truth_path(film)}")
    for array in _never_seen(truth_path(film)):
        console.note(
            f"array {array} is never whole in the picture, so no receiver reads it: move it by "
            f"channel.arrays.{array}.x_m and y_m, or film it from farther away"
        )


def _announce(film: Path, settings: "LinkSettings", codec: dict[str, Any]) -> None:
    """Say beforehand how large a film without loss becomes."""
    from heliograph.link.film import frames_of

    lossy = film.suffix.lower() == ".mp4" or codec["crf"] is not None or codec["mbit_s"] is not None
    lossy |= codec["codec"] in ("h264", "h265", "mjpeg")
    camera = settings.channel.camera
    size = frames_of(settings) * camera.width * camera.height * BYTES_PER_PIXEL
    if size >= LARGE_BYTES and (codec["lossless"] or not lossy):
        console.note(f"{film}: about {size / 1e9:.1f} GB without loss; as .mp4 it takes a fifth or less")


def _never_seen(truth: Path) -> list[int]:
    """Numbers of the arrays that no frame of a film shows as a whole."""
    from heliograph.link.truth import open_truth

    seen = [False] * len((known := open_truth(truth)).settings.channel.arrays)
    for frame in known.frames():
        seen = [before or now for before, now in zip(seen, frame.visible, strict=True)]
        if all(seen):
            break
    return [array for array, one in enumerate(seen) if not one]


def scene_from(
    preset: str, file: Path | None, assignments: list[str] | None, background: Path | None, imu: Path | None
) -> "tuple[LinkSettings, Recordings]":
    """Settings and recordings of a simulation; a recording that is given is used."""
    from heliograph.link.simulate import Recordings, load_footage, load_imu

    changes = list(assignments or ())
    if background:
        changes.insert(0, "channel.background.kind='footage'")
    if imu:
        changes.insert(0, "channel.shake='imu'")
    settings = options.settings_from(preset, file, changes)
    if settings.channel.background.kind == "footage" and not background:
        raise SettingsError("channel.background.kind=footage needs a recording: give it by --background VIDEO")
    if settings.channel.shake == "imu" and not imu:
        raise SettingsError("channel.shake=imu needs a recording: give it by --imu CSV")
    footage = load_footage(background) if background else None
    return settings, Recordings(footage=footage, imu=load_imu(imu) if imu else None)
