"""heliograph cameras."""

from heliograph.base.errors import HeliographError
from heliograph.cli import console


def run_cameras(assignments: list[str] | None, as_json: bool) -> None:
    """List the cameras that are there, and say of each kind without any what it lacks."""
    from heliograph.media.live.camera import CAMERAS, PREFIX
    from heliograph.media.live.settings import camera_settings

    settings = camera_settings(assignments or ())
    found: list[dict[str, str]] = []
    lacking: dict[str, str] = {}
    for kind in CAMERAS.names():
        try:
            cameras = (CAMERAS[kind].find or (lambda _: []))(settings)
        except HeliographError as error:
            lacking[kind] = str(error)
            continue
        if not cameras:
            own = not CAMERAS.is_built_in(kind)
            lacking[kind] = "cannot be listed; give its address" if own else "no camera answers"
        for one in cameras:
            name = f"{PREFIX}{kind}:{one.address}" if one.address else f"{PREFIX}{kind}"
            found.append({"name": name, "text": one.text})
    if as_json:
        console.say_json({"cameras": found, "lacking": lacking})
        return
    width = max((len(camera["name"]) for camera in found), default=0)
    for camera in found:
        console.say(f"{camera['name']:{width}}  {camera['text']}")
    if not found:
        console.say("no camera found")
    for kind, why in lacking.items():
        console.say_prose(f"{PREFIX}{kind}: {why}")
