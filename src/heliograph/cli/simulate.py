"""Simulation of films."""

from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.errors import SettingsError, counted
from heliograph.cli import console, options
from heliograph.cli.messages import read_messages
from heliograph.cli.options import option
from heliograph.link.film import frames_of, sent_s, write_film
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings, load_footage, load_imu
from heliograph.link.truth import truth_path


def load_scene(chosen: options.SettingsOptions, scene: options.SceneOptions) -> tuple[LinkSettings, Recordings]:
    """Return the settings and recordings of a scene."""
    defaults = ["channel.shake='imu'"] if scene.imu else []
    defaults += ["channel.background.kind='footage'"] if scene.background else []
    settings = chosen.changed(defaults).load()
    if settings.channel.background.kind == "footage" and not scene.background:
        raise SettingsError("channel.background.kind=footage needs a recording: give it by --background VIDEO")
    if settings.channel.shake == "imu" and not scene.imu:
        raise SettingsError("channel.shake=imu needs a recording: give it by --imu CSV")
    footage = load_footage(scene.background) if scene.background else None
    return settings, Recordings(footage=footage, imu=load_imu(scene.imu) if scene.imu else None)


@options.command
def simulate(
    film: Annotated[Path, typer.Argument(help="Film to write: .mkv, .nut, .mp4, .avi or .h5.")],
    *,
    settings: options.SettingsOptions,
    scene: options.SceneOptions,
    sent: options.SentOptions,
    codec: options.Codec = None,
    crf: float | None = option("Quality of lossy H.264, 0 to 51."),
    lossless: Annotated[bool, typer.Option(help="Store H.264 without loss.")] = False,
    mbit_s: float | None = option("Bit rate of H.264 or H.265 in Mbit/s, as in films of phones."),
) -> None:
    """Film a drive past the arrays, with the truth.

    The truth is written next to the film.
    """
    for output in (film, truth_path(film)):
        options.refuse_to_replace(output, (*sent.inputs, scene.background, scene.imu, settings.settings_file))
    link, recordings = load_scene(settings, scene)
    messages = read_messages(link, sent, sent_s(link))
    try:
        with console.progress("simulating", frames_of(link)) as advance:
            count = write_film(
                film, link, messages, scene.seed, recordings, advance,
                codec=codec, crf=crf, lossless=lossless, mbit_s=mbit_s,
            )  # fmt: skip
    except KeyboardInterrupt:
        frames = int(advance.done)
        kept = f"{film} holds the {counted(frames, 'frame')} so far" if frames else "nothing was written"
        console.exit_interrupted(f"interrupted; {kept}")
    console.say(f"{film}: {counted(count, 'frame')}; truth in {truth_path(film)}")
