"""heliograph cameras."""

from heliograph.cli import console


def run_cameras(assignments: list[str] | None, as_json: bool) -> None:
    """List the cameras that are there, and say of each kind without any what it lacks."""
    from heliograph.media.live.camera import PREFIX
    from heliograph.media.live.listing import cameras_there
    from heliograph.media.live.settings import camera_settings

    found, lacking = cameras_there(camera_settings(assignments or ()))
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
