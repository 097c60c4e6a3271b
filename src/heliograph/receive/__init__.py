"""Camera frames -> packets: acquire, track, equalise, decode."""

from heliograph.receive.image.pose import Pose
from heliograph.receive.packets import Codeword, Packet, Receiver
from heliograph.receive.receivers import make_receiver, own_settings, receive_frames, register_receiver
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
