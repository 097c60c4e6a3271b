"""What a live camera is: a class that connects, hands out pictures as they come, and lets go."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

from heliograph.base.errors import MediaError
from heliograph.base.frames import Pixels
from heliograph.base.registry import Registry
from heliograph.media.live.settings import CameraSettings

PREFIX = "camera:"
"""How the name of a live camera begins where a film is named."""


class CameraLostError(MediaError):
    """The camera does not answer any more: its cable was pulled, or it was switched off."""


class CameraCrashError(MediaError):
    """An unexpected exception ended the camera's own code; it is the cause of this error."""


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as the camera sent it.

    Attributes
    ----------
    pixels
        (rows, columns) gray levels; None of one that arrived in part. They are copied before the next call of
        `Camera.frames`: a camera may then fill the array again.
    number
        Its number by the camera, one more than that of the picture before; None where the camera gives none.
    stamp_ns
        Start of its exposure by the camera's own clock in ns; None where it has no clock.
    """

    pixels: Pixels | None
    number: int | None = None
    stamp_ns: int | None = None


@dataclass(frozen=True, slots=True)
class CameraForm:
    """Form of a camera's pictures, as it says once it is set.

    Attributes
    ----------
    width
        Columns of its pictures in pixels.
    height
        Rows of its pictures in pixels.
    bits
        Bits of a gray level, 8 to 16.
    rate_hz
        Pictures a second, above 0; None where the camera does not say.
    model
        Who made it and what it is called, for the user.
    settings
        Its settings as read back, by the names of `CameraSettings`.
    departures
        What it made of settings where that is not what was asked for, a text for each.
    """

    width: int
    height: int
    bits: int
    rate_hz: float | None = None
    model: str = ""
    settings: Mapping[str, object] = field(default_factory=dict)
    departures: tuple[str, ...] = ()


class Camera(Protocol):
    """A camera of some kind, before it is opened. All its methods are called by one thread at a time."""

    def open(self, settings: CameraSettings) -> CameraForm:
        """Connect, set the camera, and read back what it made of it. It takes no pictures yet.

        Parameters
        ----------
        settings
            What the user asked for. None of a setting leaves the camera as it is.

        Raises
        ------
        MediaError
            There is no such camera, or it cannot be set so.
        """

    def frames(self, wait_s: float) -> Sequence[Picture] | None:
        """Return the pictures that came since the last call; the first call starts the camera.

        Parameters
        ----------
        wait_s
            Longest time in s to wait where none has come; then there is nothing to return.

        Returns
        -------
        The pictures in their order, or None after the last one of a camera that ends.

        Raises
        ------
        CameraLostError
            The camera does not answer any more; it is closed, and another one is made and opened.
        """

    def close(self) -> None:
        """Stop the camera and let go of it, whatever its state; it may have been lost. Never raises."""


@dataclass(frozen=True, slots=True)
class Found:
    """A camera that is there."""

    # What its kind knows it by, such as a serial number; empty where the kind has one camera alone
    address: str
    # Who made it and how it is connected, for the user
    text: str


class CameraKind(NamedTuple):
    """Cameras of a kind."""

    # Makes a camera of its address; the empty address is that of the first one
    make: Callable[[str], Camera]
    # Lists what is there; a MediaError says why there is nothing, and what to do. None where it cannot be told
    find: Callable[[CameraSettings], list[Found]] | None = None


CAMERAS: Registry[CameraKind] = Registry(
    "camera",
    "heliograph.cameras",
    {
        "aravis": "heliograph.media.live.aravis:KIND",
        "genicam": "heliograph.media.live.genicam:KIND",
        "webcam": "heliograph.media.live.webcam:KIND",
    },
)
"""Kinds of cameras by the word after ``camera:``; a `CameraKind`."""


def register_camera(
    name: str, make: Callable[[str], Camera], find: Callable[[CameraSettings], list[Found]] | None = None
) -> None:
    """Register a kind of camera of one's own.

    It is then read wherever a film is: ``camera:NAME`` or ``camera:NAME:ADDRESS``. Packages offer cameras without a
    call, by an entry point of the group "heliograph.cameras" that names a `CameraKind`.

    Parameters
    ----------
    name
        Its name: letters, digits, "-", "_" and ".".
    make
        Makes a `Camera` of its address, a text that is empty where none is given; a class with such a constructor will
        do.
    find
        Lists the cameras that are there for ``heliograph cameras``; it takes the `CameraSettings` of the command.

    Raises
    ------
    SettingsError
        The name is that of a kind of the package, or is no name; or `make` is no function.
    """
    CAMERAS.register(name, CameraKind(make, find), make)


def camera_kind(name: str) -> tuple[CameraKind, str]:
    """Return the kind and the address of a camera's name."""
    kind, _, address = name.removeprefix(PREFIX).partition(":")
    if not kind:
        raise MediaError(f"a camera is {PREFIX}KIND or {PREFIX}KIND:ADDRESS; 'heliograph cameras' lists what is there")
    return CAMERAS[kind], address
