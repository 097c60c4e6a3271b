"""The live cameras that are there."""

from heliograph.base.errors import HeliographError
from heliograph.media.live.camera import CAMERAS, PREFIX
from heliograph.media.live.settings import CameraSettings


def cameras_there(settings: CameraSettings) -> tuple[list[dict[str, str]], dict[str, str]]:
    """Return the cameras that answer, with `name` and `text`, and for each kind without any what it lacks."""
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
    return found, lacking
