"""Turbo code of 3GPP TS 36.212: encoder, rate matching, soft-in soft-out decoder.

LLR = ln P(b=0)/P(b=1). Importing this costs NumPy only; Numba comes with the first decoding.
"""

from heliograph.signal.turbo.code import TurboCode
from heliograph.signal.turbo.options import Check, DecoderOptions, TurboResult
from heliograph.signal.turbo.qpp import QPP_SIZES, nearest_size

__all__ = ["QPP_SIZES", "Check", "DecoderOptions", "TurboCode", "TurboResult", "nearest_size"]
