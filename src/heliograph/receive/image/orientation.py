"""How the camera sees an array turned: upside-down, on its side, or by way of a mirror."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Orientation:
    """One of the eight ways in which a square can lie."""

    # Quarter turns, clockwise in the image, 0 to 3
    turns: int = 0
    # Whether left and right change places before it is turned
    mirrored: bool = False

    def __str__(self) -> str:
        """Its name, as packets state it: "upright", "turned 90", "mirrored", "mirrored, turned 90" and so on."""
        turned = f"turned {90 * self.turns}" if self.turns else ""
        return ", ".join(filter(None, ("mirrored" if self.mirrored else "", turned))) or "upright"

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(2, 2) map of a vector (x, y) of the upright image to that of the turned one: a signed permutation."""
        mirror = np.diag([-1.0 if self.mirrored else 1.0, 1.0])
        quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
        return np.asarray(np.linalg.matrix_power(quarter, self.turns) @ mirror)

    def turned(self, image: NDArray[Any]) -> NDArray[Any]:
        """An upright image as the camera sees it."""
        return np.ascontiguousarray(np.rot90(image[:, ::-1] if self.mirrored else image, -self.turns))

    def upright(self, image: NDArray[Any]) -> NDArray[Any]:
        """What the camera sees, turned back; the inverse of `turned`."""
        back = np.rot90(image, self.turns)
        return np.ascontiguousarray(back[:, ::-1] if self.mirrored else back)


UPRIGHT = Orientation()
"""That of a camera that stands upright and looks straight at the array."""

ORIENTATIONS = tuple(Orientation(turns, mirrored) for mirrored in (False, True) for turns in range(4))
"""All eight, the upright one first."""
