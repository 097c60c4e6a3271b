"""Transmitter: messages to timed LED patterns."""

from heliograph.transmit.transmitter import Content, TimedPattern, TransmitSettings, Transmitter

__all__ = ["Content", "TimedPattern", "TransmitSettings", "Transmitter"]
