"""Camera frames -> packets: detect, track, equalise, decode."""

from heliograph.receive.api import list_receivers, make_receiver, own_settings, receive_frames, register_receiver
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.luminance_receiver import LuminanceReceiver
from heliograph.receive.packet import Codeword, Packet, Receiver
from heliograph.receive.settings import ReceiveSettings

__all__ = [
    "Codeword",
    "LuminanceReceiver",
    "Packet",
    "Pose",
    "ReceiveSettings",
    "Receiver",
    "list_receivers",
    "make_receiver",
    "own_settings",
    "receive_frames",
    "register_receiver",
]
