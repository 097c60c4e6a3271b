"""The turbo code of a layer: how many codewords share its bits, and of what size (section 9.1)."""

from heliograph.signal.code import CodePlan
from heliograph.signal.turbo.code import HIGHEST_RATE, TurboCode
from heliograph.signal.turbo.qpp import QPP_SIZES

_SIZE_SLACK = 32
"""Information bits by which r E may exceed the largest interleaver (section 9.1): half the step between the largest
sizes, so that K is no further from r E than rounding to a size takes it. At 0, 4 of 4320 layers tried (8 to 32 LEDs a
side, 20 to 199 data pairs, eight rates) need more and shorter codewords; a larger slack may lower the rate further."""


def turbo_plan(bits: int, rate: float) -> CodePlan:
    """Plan a layer by section 9.1: the fewest codewords, equal in size, that keep K within the interleavers.

    Parameters
    ----------
    bits
        Coded bits of the layer, 1 or more.
    rate
        Information bits by coded bit, above 0 and at most 9/10.

    Raises
    ------
    ValueError
        The bits are too few for the smallest interleaver.
    """
    most, of = HIGHEST_RATE
    for split in range(1, bits + 1):
        e = bits // split
        if bits % split == 0 and rate * e <= QPP_SIZES[-1] + _SIZE_SLACK:
            break
    k = min((k for k in QPP_SIZES if of * k <= most * e), key=lambda k: abs(k - rate * e), default=0)
    if not k:
        raise ValueError(f"{e} bits a codeword hold no block of {QPP_SIZES[0]} bits at rate {most}/{of}")
    return CodePlan(split, TurboCode(k=k, coded_bits=e))
