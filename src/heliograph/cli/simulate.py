"""Simulation of films."""

from pathlib import Path
from typing import Any

from heliograph.base.errors import SettingsError
from heliograph.base.words import counted
from heliograph.cli import console
from heliograph.cli.messages import read_messages
from heliograph.cli.options import SceneOptions, SentOptions, SettingsOptions, refuse_to_replace
from heliograph.link.film import frames_of, sent_s, write_film
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Recordings, load_footage, load_imu
from heliograph.link.truth import open_truth, truth_path


def load_scene(settings_options: SettingsOptions, scene: SceneOptions) -> tuple[LinkSettings, Recordings]:
    """Return the settings and recordings of a scene."""
    defaults = ["channel.shake='imu'"] if scene.imu else []
    defaults += ["channel.background.kind='footage'"] if scene.background else []
    settings = settings_options.changed(defaults).load()
    if settings.channel.background.kind == "footage" and not scene.background:
        raise SettingsError("channel.background.kind=footage needs a recording: give it by --background VIDEO")
    if settings.channel.shake == "imu" and not scene.imu:
        raise SettingsError("channel.shake=imu needs a recording: give it by --imu CSV")
    footage = load_footage(scene.background) if scene.background else None
    return settings, Recordings(footage=footage, imu=load_imu(scene.imu) if scene.imu else None)


def run_simulate(
    film: Path, settings_options: SettingsOptions, scene: SceneOptions, sent: SentOptions, form: dict[str, Any]
) -> None:
    """Simulate a film and the truth."""
    for output in (film, truth_path(film)):
        refuse_to_replace(output, (*sent.inputs, scene.background, scene.imu, settings_options.settings_file))
    settings, recordings = load_scene(settings_options, scene)
    messages = read_messages(settings, sent, sent_s(settings))
    _announce_size(film, settings, form)
    try:
        with console.progress("simulating", frames_of(settings)) as advance:
            count = write_film(film, settings, messages, scene.seed, recordings, advance, **form)
    except KeyboardInterrupt:
        frames = int(advance.done)
        kept = f"{film} holds the {counted(frames, 'frame')} so far" if frames else "nothing was written"
        console.exit_interrupted(f"interrupted; {kept}")
    console.say(f"{film}: {counted(count, 'frame')}; truth in {truth_path(film)}")
    for array in _invisible_arrays(truth_path(film)):
        console.note(
            f"array {array} is never completely in the picture, so no receiver reads it: move it by "
            f"channel.arrays.{array}.x_m and y_m, or film it from farther away"
        )


def _announce_size(film: Path, settings: LinkSettings, form: dict[str, Any]) -> None:
    """Print the size of a large lossless film."""
    is_lossy = film.suffix.lower() == ".mp4" or form["crf"] is not None or form["mbit_s"] is not None
    is_lossy |= form["codec"] in ("h264", "h265", "mjpeg")
    camera = settings.channel.camera
    # lossless compression of the paper's drive needs 0.35 bytes per pixel
    size = 0.35 * frames_of(settings) * camera.width * camera.height
    if size >= 2e8 and (form["lossless"] or not is_lossy):
        console.note(f"{film}: about {size / 1e9:.1f} GB without loss; as .mp4 at most a fifth")


def _invisible_arrays(path: Path) -> list[int]:
    """Return the numbers of the arrays that are never completely visible."""
    truth = open_truth(path)
    invisible = set(range(len(truth.settings.channel.arrays)))
    for frame in truth.frames():
        invisible -= {array for array, is_visible in enumerate(frame.visible) if is_visible}
        if not invisible:
            break
    return sorted(invisible)
