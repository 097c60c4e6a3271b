"""Quantities of the scene with the values that settings may give them."""

from typing import Annotated

from pydantic import AfterValidator, Field


def _lit(colour: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(colour):
        raise ValueError("a colour has red, green or blue above 0, not (0, 0, 0)")
    return colour


LightLevel = Annotated[float, Field(ge=0, le=4)]
"""Light in full scales. Chosen bound: four times saturation."""

Colour = Annotated[tuple[LightLevel, LightLevel, LightLevel], AfterValidator(_lit)]
"""Red, green and blue of a light, by those of what the camera shows as gray: (1, 1, 1) is gray."""

Probability = Annotated[float, Field(ge=0, lt=1)]
"""Probability of an accident of a frame."""

Ppm = Annotated[float, Field(ge=-1e4, le=1e4)]
"""Error of a clock's period in millionths. Chosen bound: 1 %, a hundred times what the air interface allows."""

LengthM = Annotated[float, Field(ge=-1e4, le=1e4)]
"""Place in the scene in m. Chosen bound: 10 km, from which no array is seen."""

SpeedMS = Annotated[float, Field(ge=-1000, le=1000)]
"""Velocity in m/s. Chosen bound: ten times that of a fast train."""

TimeS = Annotated[float, Field(ge=-60, le=3600)]
"""Start of a clock in s. What an array shows before the film is computed too, so that a minute is the most."""

TiltDeg = Annotated[float, Field(gt=-90, lt=90)]
"""Angle of an array's tilt in degrees: at 90 it is seen from its edge."""
