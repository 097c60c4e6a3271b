"""Camera frames -> packets: detect, track, extract, decode."""

from heliograph.receive.packets import Codeword, Observer, Packet
from heliograph.receive.pose import Pose
from heliograph.receive.receiver import Receiver
from heliograph.receive.receivers import make_receiver, receive_frames
from heliograph.receive.settings import ReceiveSettings

__all__ = ["Codeword", "Observer", "Packet", "Pose", "ReceiveSettings", "Receiver", "make_receiver", "receive_frames"]
