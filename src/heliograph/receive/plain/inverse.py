"""Inverse of the channel: the LEDs' luminances by least squares on all pixels, the blur of all LEDs known.

Every LED shines on its neighbours' pixels too. With the pose and the blur known, the blur matrix A is known, and the
difference of pattern and inverse is A (2 x - 1). Each LED's image is a product of a function of x and one of y,
whatever the roll, so A^T A is the product of two small Gram matrices, element by element, and A itself is never made.
"""

import numpy as np
from scipy.linalg import lapack

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.image.footprint import footprints, image_of, to_grid
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.window import PlacedPixels, cut_out, window_around

ZERO_FORCING_LOADING = 1e-4
"""lambda: loading of the diagonal of A^T A, in units in which a wide array with all LEDs on has the image 1.

Zero-forcing is meant, so lambda is no more than the noise is worth: (noise / light)^2 = 2 (0.006 / 0.8)^2 = 1e-4 for
LEDs of +-1 in the difference of two frames of the reference link. To 55 m it changes nothing. From 60 m on there are
combinations of LEDs that hardly any pixel sees, and lambda keeps their noise out of all others.
"""

INVERSE_MARGIN_PX = 2.5
"""Pixels beyond the array that are used: LEDs of its rim shine there."""


def unblurred(
    frames: tuple[PlacedPixels, PlacedPixels],
    poses: tuple[Pose, Pose],
    gain: float,
    side: int,
    loading: float = ZERO_FORCING_LOADING,
) -> Floats:
    """Normalised luminances x' = level - 2 of a pair, the blur undone.

    With A_1 and A_2 at the poses of the two frames, the background equal in both and s = 2 x - 1:

        d = (r - r_inverted) / gain = A_1 x - A_2 (1 - x) = M s + (A_1 - A_2) 1 / 2,  M = (A_1 + A_2) / 2
        s = (M^T M + lambda I)^-1 M^T (d - (A_1 - A_2) 1 / 2)

    M is taken as A at the pose between the two, its blur wider by the motion: sigma^2 + (half the motion)^2.
    """
    middle = Pose.midway(*poses)
    motion = 0.5 * (poses[1].x - poses[0].x), 0.5 * (poses[1].y - poses[0].y)
    window = window_around(middle, side, INVERSE_MARGIN_PX + max(abs(motion[0]), abs(motion[1])))
    corner, shape = (window[0], window[1]), (window[3], window[2])
    change = (cut_out(frames[0], window) - cut_out(frames[1], window)) / max(gain, TINY)
    ones = np.ones((side, side))
    change -= 0.5 * (image_of(ones, poses[0], corner, shape) - image_of(ones, poses[1], corner, shape))
    across, down = footprints(middle, corner, shape, side, motion).dense(shape)
    # M^T M: <led_i, led_j> = <across_i, across_j> <down_i, down_j>
    gram = (across @ across.T) * (down @ down.T)
    gram[np.diag_indices_from(gram)] += loading
    light = np.einsum("kj,kj->k", down @ change, across)
    _, s, _ = lapack.dposv(gram, light, overwrite_a=1)
    return 2 * to_grid(s)
