"""Command line and pages handle the colour range equally, with or without a tag."""

import json
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from cli_runs import within
from fastapi.testclient import TestClient
from web_server import OWN

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.web.app import create_app
from heliograph.web.failures import FailureRecorder

pytestmark = pytest.mark.usefixtures("quick_ends")
WHITE, DARK = 0.75, 40
FRAMES, SIDE = 24, 64
UNTAGGED, LIMITED, FULL = 0, 1, 2


def write_video(path: Path, codec: str, form: str, span: int, white: int) -> None:
    """Write frames that are three quarters white; the rest is dark and changes."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=30, options={"qp": "0"} if codec == "libx264" else {})
        stream.width, stream.height, stream.pix_fmt = SIDE, SIDE, form
        stream.codec_context.color_range = span
        planes = np.full((SIDE * 3 // 2, SIDE), 128, np.uint8)
        planes[:SIDE] = white
        for k in range(FRAMES):
            planes[:SIDE, : SIDE // 4] = DARK + k
            frame = av.VideoFrame.from_ndarray(planes[:SIDE] if form == "gray" else planes, format=form)
            frame.color_range, frame.pts = span, k
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))


FILMS = {
    "untagged.mp4": ("libx264", "yuv420p", UNTAGGED, 235),
    "limited.mp4": ("libx264", "yuv420p", LIMITED, 235),
    "full.mp4": ("libx264", "yuv420p", FULL, 255),
    "motion.avi": ("mjpeg", "yuvj420p", FULL, 255),
    "raw.y4m": ("rawvideo", "yuv420p", UNTAGGED, 235),
    "raw.avi": ("rawvideo", "gray", UNTAGGED, 255),
}
"""Codec, pixel format, tag and level of white."""


@pytest.mark.parametrize("name", FILMS)
def test_probe_and_pages_see_the_same_full_scale(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / name
    write_video(path, *FILMS[name])
    run = within(tmp_path, "probe", path, "--json", "--preset", "phone")
    assert json.loads(run.stdout)["levels"]["at_full_scale"] == pytest.approx(WHITE, abs=0.01)
    seen: list[Frame] = []

    def add_frame(_recorder: FailureRecorder, frame: Frame) -> None:
        seen.append(frame)
        if len(seen) == FRAMES:
            raise MediaError("seen")  # ends the reception

    monkeypatch.setattr(FailureRecorder, "add_frame", add_frame)
    with TestClient(create_app(films=[str(path)]), base_url=OWN) as client:
        film = client.put(f"/api/films?kind={path.suffix[1:]}", content=path.read_bytes()).json()["film"]
        receive: Any = {"kind": "film", "film": film, "side": 16, "rate_hz": 10}
        watch: Any = {"do": "open", "source": {"kind": "named", "preset": "phone"}}
        for page, request in (("receive", receive), ("watch", watch)):
            seen.clear()
            with client.websocket_connect(f"ws://127.0.0.1:8000/api/{page}", ["heliograph"]) as socket:
                socket.send_json(request)
                while "seen" not in (socket.receive().get("text") or ""):
                    pass
            share = np.mean([np.mean(frame.pixels == frame.full_scale) for frame in seen])
            assert share == pytest.approx(WHITE, abs=0.01)
