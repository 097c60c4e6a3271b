"""Messages -> timed LED patterns."""

from heliograph.transmit.transmitter import TimedPattern, Transmitter, TransmitSettings

__all__ = ["TimedPattern", "TransmitSettings", "Transmitter"]
