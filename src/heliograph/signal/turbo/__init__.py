"""Turbo code from 3GPP TS 36.212 (section 9): encoder, rate matching, soft-in soft-out decoder.

LLR = ln P(b=0)/P(b=1). The first decoding imports Numba.
"""

from heliograph.signal.code import Check
from heliograph.signal.turbo.code import HIGHEST_RATE, DecoderOptions, TurboCode, TurboResult
from heliograph.signal.turbo.qpp import QPP_SIZES

__all__ = ["HIGHEST_RATE", "QPP_SIZES", "Check", "DecoderOptions", "TurboCode", "TurboResult"]
