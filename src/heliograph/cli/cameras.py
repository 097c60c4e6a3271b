"""List of live cameras."""

from heliograph.cli import console, options
from heliograph.media.live.camera import PREFIX, list_cameras
from heliograph.media.live.settings import camera_settings


@options.command
def cameras(camera: options.CameraOption = None, as_json: options.Json = False) -> None:
    """List the connected live cameras.

    Prints the names for 'receive', and the missing requirements of other kinds.
    """
    found, missing = list_cameras(camera_settings(camera or ()))
    if as_json:
        console.say_json({"cameras": found, "lacking": missing})
        return
    width = max((len(entry["name"]) for entry in found), default=0)
    for entry in found:
        console.say(f"{entry['name']:{width}}  {entry['text']}")
    if not found:
        console.say("no camera found")
    for kind, reason in missing.items():
        console.say_prose(f"{PREFIX}{kind}: {reason}")
