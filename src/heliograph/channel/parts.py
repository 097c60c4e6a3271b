"""Registries of camera motions, backgrounds and point-spread functions.

Programs extend them with `register_motion`, `register_background` and `register_point_spread`, installed packages with
entry points of the groups "heliograph.motions", "heliograph.backgrounds" and "heliograph.point_spreads".
"""

from collections.abc import Callable
from typing import Any

from heliograph.base.registry import Registry

Maker = Callable[..., Any]

MOTIONS: Registry[Maker] = Registry(
    "motion",
    "heliograph.motions",
    {kind: f"heliograph.channel.motion:{kind}_motion" for kind in ("none", "road", "imu", "hand")},
)
"""Motions by ``channel.shake``; each takes a `motion.Drive` and returns a `motion.Shake`."""

BACKGROUNDS: Registry[Maker] = Registry(
    "background",
    "heliograph.backgrounds",
    {
        kind: f"heliograph.channel.background:{kind.replace('-', '_')}_background"
        for kind in ("flat", "synthetic", "street", "street-night", "footage")
    },
)
"""Backgrounds by ``channel.background.kind``; each takes a `background.Scenery` and returns a `background.Painter`."""

POINT_SPREADS: Registry[Maker] = Registry(
    "point-spread function",
    "heliograph.point_spreads",
    {kind: f"heliograph.channel.psf:{kind}_spread" for kind in ("gaussian", "halo")},
)
"""Point-spread functions by ``channel.camera.psf``; each takes `CameraSettings` and returns a `psf.PointSpread`."""


def register_motion(name: str, make: Maker) -> None:
    """Register a motion of the camera.

    Parameters
    ----------
    name
        Value of ``channel.shake``.
    make
        Takes a `heliograph.channel.motion.Drive`; returns a function of times (...) in s that gives (..., 4) heave in m
        and pitch, yaw and roll in rad, or None for no motion.

    Raises
    ------
    SettingsError
        The name is invalid or belongs to a built-in part, or `make` is no function.
    """
    MOTIONS.register(name, make, make)


def register_background(name: str, make: Maker) -> None:
    """Register a background.

    Parameters
    ----------
    name
        Value of ``channel.background.kind``.
    make
        Takes a `heliograph.channel.background.Scenery`; returns a `heliograph.channel.background.Painter`.

    Raises
    ------
    SettingsError
        The name is invalid or belongs to a built-in part, or `make` is no function.
    """
    BACKGROUNDS.register(name, make, make)


def register_point_spread(name: str, make: Maker) -> None:
    """Register a point-spread function.

    Parameters
    ----------
    name
        Value of ``channel.camera.psf``.
    make
        Takes `CameraSettings`; returns a `heliograph.channel.psf.PointSpread`.

    Raises
    ------
    SettingsError
        The name is invalid or belongs to a built-in part, or `make` is no function.
    """
    POINT_SPREADS.register(name, make, make)
