"""What comes before an array from a side: it covers the array's surroundings before it hides an LED.

The sum of a pattern and its inverse shows all LEDs and the background, whatever is sent. Along a column or a row of
LEDs, and along a line beside the array, it hardly changes from pair to pair. A post that comes near changes it at once.
Its light would pull the pose: an array seems to end where a post begins.
"""

from heliograph.receive.image.pose import Pose

BESIDE_PITCHES, BESIDE_PX = 1.5, 2.0
"""Distance of a line beside the array from its edge, in pitches, and at least in px.

2 px from an edge a blur of 0.7 px leaves 0.2 % of the array's light, and 8 % of an array 1 px off its place.
"""

LEAST_CHANGED = 0.15
"""Least change of a line that counts, as a fraction of the array's light.

Without it posts pull the pose: of 7389 pairs in 44 passages 931 were off by over half a pitch, with it 613 of 7281.
"""


def line_distance(pose: Pose, side: int) -> float:
    """Distance of the lines beside an array from its centre, in pitches."""
    return 0.5 * side + max(BESIDE_PITCHES, BESIDE_PX / pose.pitch)
