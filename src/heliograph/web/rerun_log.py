"""Reception as a recording for the viewer Rerun: frames, tracked arrays, soft values, codewords, events."""

import contextlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.files import whole_file
from heliograph.base.frames import Frame
from heliograph.measure.journal import sentence
from heliograph.receive.events import DecodeEvent, EqualiseEvent, ExtractEvent, LostEvent, TrackEvent
from heliograph.receive.geometry.window import AnyFrame, cut_out, window_around
from heliograph.receive.settings import CalibrationSettings
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import LAYER_COLOURS

FRAMES_PER_S = 50
"""Maximum number of complete camera frames per second of film; cut-outs of pairs are recorded at any rate."""


@contextlib.contextmanager
def open_rerun(path: str | Path, side: int, calibration: CalibrationSettings) -> Iterator["RerunLog"]:
    """Write a recording during the block; raise a HeliographError if the package rerun-sdk is missing."""
    try:
        import rerun
        from rerun import blueprint as layout
    except ImportError:
        needs = "a recording for Rerun needs the package rerun-sdk"
        raise HeliographError(f"{needs}: pip install 'heliograph[rerun]'") from None
    panels = [
        layout.TimeSeriesView(origin="distance", name="distance in m"),
        *(
            layout.TimeSeriesView(origin=origin, name=name, axis_y=layout.ScalarAxis(range=(-0.1, 1.1)))
            for origin, name in (("codewords", "codewords, 1 if decoded"), ("information", "bit per coded bit"))
        ),
        layout.Tabs(
            layout.Grid(layout.Spatial2DView(origin="pairs"), name="pattern and inverse"),
            layout.BarChartView(origin="soft-values", name="soft values"),
        ),
    ]
    film = layout.Vertical(
        layout.Spatial2DView(origin="camera", name="camera"), layout.TextLogView(origin="events"), row_shares=[3, 1]
    )
    with whole_file(Path(path)) as partial:
        stream = rerun.RecordingStream("heliograph")
        stream.save(partial, layout.Blueprint(layout.Horizontal(film, layout.Vertical(*panels), column_shares=[3, 2])))
        try:
            yield RerunLog(rerun, stream, side, calibration)
        finally:
            stream.disconnect()


class RerunLog:
    """Observer of a reception that writes to a recording; everything has the time of the last frame."""

    def __init__(self, rerun: Any, stream: Any, side: int, calibration: CalibrationSettings):
        self._rr, self._stream, self._side, self._calibration = rerun, stream, side, calibration
        self._shown_s = -np.inf
        for layer, colour in LAYER_COLOURS.items():
            points = rerun.SeriesPoints(colors=[int(f"{colour[1:]}ff", 16)], names=[layer])
            for quantity in ("codewords", "information"):
                stream.log(f"{quantity}/{layer}", points, static=True)

    def frame(self, frame: Frame) -> None:
        """Record a camera frame."""
        self._stream.set_time("film", duration=frame.time_s)
        if frame.time_s - self._shown_s >= 1 / FRAMES_PER_S:
            self._shown_s = frame.time_s
            image = self._rr.Image(_in_8_bits(frame.pixels, frame))
            self._stream.log("camera", image.compress(jpeg_quality=85))

    def observe(self, event: object) -> None:
        """Record an event of the receiver."""
        rr, log = self._rr, self._stream.log
        match event:
            case TrackEvent(identity=identity):
                pose = event.view.pose_out(event.tracked.state.pose)
                corners = pose.leds(self._side)[[0, 0, -1, -1, 0], [0, -1, -1, 0, 0]]
                distance_m = self._calibration.distance_m(pose)
                label, colour = (
                    f"array {identity}, {distance_m:.1f} m",
                    0xFFB300FF if event.tracked.seen else 0xFF6E6EFF,
                )
                log(f"camera/array-{identity}", rr.LineStrips2D([corners], labels=[label], colors=[colour]))
                log(f"distance/array-{identity}", rr.Scalars(distance_m))
            case ExtractEvent():
                for name, frame, pose in zip(("pattern", "inverse"), event.frames, event.poses, strict=True):
                    window = window_around(pose, self._side, 0.25 * self._side * pose.pitch)
                    cut = rr.Image(_in_8_bits(cut_out(frame, window), frame))
                    log(f"pairs/array-{event.identity}/{name}", cut)
            case EqualiseEvent():
                for layer, llr in event.llr.items():
                    counts, edges = np.histogram(np.clip(llr, -20, 20), 41, (-20, 20))
                    log(f"soft-values/array-{event.identity}/{layer}", rr.BarChart(counts, abscissa=edges[:-1]))
            case DecodeEvent():
                for layer in LAYERS:
                    for word in event.packet.layers.get(layer, ()):
                        log(f"codewords/{layer}", rr.Scalars(float(word.status == "ok")))
                        if np.isfinite(word.information):
                            log(f"information/{layer}", rr.Scalars(word.information))
            case LostEvent():
                log(f"camera/array-{event.identity}", rr.Clear(recursive=True))

    def tell(self, row: Mapping[str, Any]) -> None:
        """Record a row of the journal as text."""
        has_failed = row["event"] == "packet" and row["status"] != "ok"
        self._stream.log("events", self._rr.TextLog(sentence(row), level="WARN" if has_failed else "INFO"))


def _in_8_bits(pixels: Any, frame: AnyFrame) -> Any:
    """Convert gray levels to 8 bits, from 0 to the camera's full scale."""
    return pixels if pixels.dtype == np.uint8 else np.clip(pixels * (255 / frame.full_scale), 0, 255).astype(np.uint8)
