"""The transmitter: messages -> timed LED patterns."""

from heliograph.transmit.transmitter import TimedPattern, TransmitSettings, Transmitter

__all__ = ["TimedPattern", "TransmitSettings", "Transmitter"]
