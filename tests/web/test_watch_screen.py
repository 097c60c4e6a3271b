"""Drawings on page *Watch* for the receiver "screen": boxes, cut-outs, packet light."""

from base64 import b64decode
from typing import Any

import numpy as np
import pytest

import heliograph
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.web.watching.scene import Scene, SceneObserver

SMALL = (
    "channel.camera.width=480",
    "channel.camera.height=270",
    "channel.camera.pixel_m=1.1e-5",
    "channel.camera.row_time_s=5e-5",
    "channel.distance_m=0.75",
    "channel.duration_s=1.2",
    "receive.calibration.pixel_m=1.1e-5",
)


@pytest.mark.slow
def test_screen_is_drawn_with_box_cut_outs_and_light() -> None:
    settings = load_settings("phone-60", None, SMALL)
    seen = SceneObserver(settings.signal, settings.receive.calibration)
    receiver = heliograph.make_receiver(settings.signal, settings.receive, seen)
    scenes, light = list[Scene](), list[dict[str, Any]]()
    for frame, _ in simulate(settings, default_messages(settings), 3):
        for packet in receiver.push(frame):
            assert packet.status == "ok"
        light += seen.packet_rows()
        scenes.append(seen.scene(frame))
    drawn = [one for one in scenes if one.boxes]
    assert len(drawn) > 20
    assert all(one.boxes[0]["distance_m"] == pytest.approx(0.75, rel=0.1) for one in drawn)
    has_cut = [bool(one.cuts) for one in drawn]
    assert sum(has_cut) > 15
    assert all(has_cut[has_cut.index(True) :]), "the cut-out flickers"
    received, decided = (np.frombuffer(b64decode(light[0][name]["data"]), np.uint8) for name in ("received", "decided"))
    places = np.round((np.arange(16) - 7.5) * 72 / (1.3 * 16) + 35.5).astype(int)
    assert np.corrcoef(received.reshape(72, 72)[np.ix_(places, places)].ravel(), decided)[0, 1] > 0.5
