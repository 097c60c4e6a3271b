"""Camera frames -> packets: detect, track, equalise, decode."""

from heliograph.receive.api import make_receiver, own_settings, receive_frames, register_receiver
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.packet import Codeword, Packet, Receiver
from heliograph.receive.settings import ReceiveSettings

__all__ = [
    "Codeword",
    "Packet",
    "Pose",
    "ReceiveSettings",
    "Receiver",
    "make_receiver",
    "own_settings",
    "receive_frames",
    "register_receiver",
]
