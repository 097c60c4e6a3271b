"""Transmitter: messages to timed LED patterns."""

from heliograph.transmit.transmitter import Content, Messages, TimedPattern, TransmitSettings, Transmitter

__all__ = ["Content", "Messages", "TimedPattern", "TransmitSettings", "Transmitter"]
