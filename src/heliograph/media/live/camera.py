"""Protocol of a live camera, the kinds of cameras by name, and the list of present cameras."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.frames import Pixels
from heliograph.base.registry import Registry
from heliograph.media.live.settings import CameraSettings

PREFIX = "camera:"  # first characters of the name of a live camera


class CameraLostError(MediaError):
    """The camera has stopped answering: the cable was pulled, or the power is off."""


class CameraCrashError(MediaError):
    """An unexpected exception in the code of the camera, the cause of this error."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as the camera sent it.

    Attributes
    ----------
    pixels
        (rows, columns) gray levels; None if the picture is incomplete. The reader copies the pixels before the
        next call of `Camera.frames`: a camera may reuse the array.
    number
        Frame number of the camera, incremented for each picture; None if the camera gives none.
    stamp_ns
        Start of the exposure by the camera's clock in ns; None if the camera has no clock.
    """

    pixels: Pixels | None
    number: int | None = None
    stamp_ns: int | None = None


@dataclass(frozen=True, slots=True)
class CameraForm:
    """Form of a camera's pictures with the settings applied.

    Attributes
    ----------
    width
        Columns of a picture in pixels.
    height
        Rows of a picture in pixels.
    bits
        Bits of a gray level, 8 to 16.
    rate_hz
        Pictures a second, above 0; None if the camera does not state it.
    model
        Maker and model, for the user.
    settings
        Settings as read back, by the names of `CameraSettings`.
    departures
        A text for each setting with another value than the requested.
    """

    width: int
    height: int
    bits: int
    rate_hz: float | None = None
    model: str = ""
    settings: Mapping[str, object] = field(default_factory=dict)
    departures: tuple[str, ...] = ()


class Camera(Protocol):
    """A camera of some kind, before it is opened. The methods are called from a single thread at a time."""

    def open(self, settings: CameraSettings) -> CameraForm:
        """Connect, apply and read back the settings; start no acquisition yet.

        Parameters
        ----------
        settings
            Requested settings. None leaves a setting unchanged.

        Raises
        ------
        MediaError
            The camera is missing, or refuses a setting.
        """

    def frames(self, wait_s: float) -> Sequence[Picture] | None:
        """Return the pictures since the last call; the first call starts the acquisition.

        Parameters
        ----------
        wait_s
            Longest time in s to wait for a picture; then return an empty sequence.

        Returns
        -------
        The pictures in order, or None after the last picture.

        Raises
        ------
        CameraLostError
            The camera has stopped answering. The reader closes this camera, then makes and opens another.
        """

    def close(self) -> None:
        """Stop and release the camera in any state, even after it was lost. Never raises."""


@dataclass(frozen=True, slots=True)
class Found:
    """A present camera."""

    # Address within the kind, such as a serial number; empty if the kind has a single camera
    address: str
    # Maker and connection, for the user
    text: str


class CameraKind(NamedTuple):
    """Cameras of a kind."""

    # Makes a camera from an address; the empty address selects the first camera
    make: Callable[[str], Camera]
    # Lists present cameras; a MediaError gives the reason for an empty list and the cure. None if it cannot be known
    find: Callable[[CameraSettings], list[Found]] | None = None


_BUILT_IN = {name: f"heliograph.media.live.{name}:KIND" for name in ("aravis", "genicam", "webcam")}
CAMERAS: Registry[CameraKind] = Registry("camera", "heliograph.cameras", _BUILT_IN)
"""Kinds of cameras by the word after ``camera:``."""


def register_camera(
    name: str, make: Callable[[str], Camera], find: Callable[[CameraSettings], list[Found]] | None = None
) -> None:
    """Register a user-defined kind of camera.

    Commands and functions then accept ``camera:NAME`` or ``camera:NAME:ADDRESS`` as a film. An entry point of the group
    "heliograph.cameras" with a `CameraKind` registers cameras of a package automatically.

    Parameters
    ----------
    name
        Name of the kind: letters, digits, "-", "_" and ".".
    make
        Makes a `Camera` from an address, a possibly empty text; a class with such a constructor is enough.
    find
        Lists present cameras for ``heliograph cameras``, given the `CameraSettings` of the command.

    Raises
    ------
    SettingsError
        The package has a kind of this name, the name is invalid, or `make` is no function.
    """
    CAMERAS.register(name, CameraKind(make, find), make)


def camera_kind(name: str) -> tuple[CameraKind, str]:
    """Return the kind and the address of a camera's name."""
    kind, _, address = name.removeprefix(PREFIX).partition(":")
    if not kind:
        raise MediaError(f"a camera is {PREFIX}KIND or {PREFIX}KIND:ADDRESS; see 'heliograph cameras'")
    return CAMERAS[kind], address


def list_cameras(settings: CameraSettings) -> tuple[list[dict[str, str]], dict[str, str]]:
    """Return the name and text of each present camera, and the reason for each kind that has no cameras."""
    found: list[dict[str, str]] = []
    lacking: dict[str, str] = {}
    for kind in CAMERAS.names():
        find = CAMERAS[kind].find
        try:
            cameras = find(settings) if find else []
        except HeliographError as error:
            lacking[kind] = str(error)
            continue
        if not cameras:
            built_in = kind in CAMERAS.built_in
            lacking[kind] = "no camera answers" if built_in else "cannot be listed; give the address"
        for camera in cameras:
            name = f"{PREFIX}{kind}:{camera.address}".rstrip(":")
            found.append({"name": name, "text": camera.text})
    return found, lacking
