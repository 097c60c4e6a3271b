"""Scenes for display: frame, boxes and cut-outs of arrays; and the light of decoded packets."""

import json
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from heliograph.base.frames import Frame
from heliograph.receive.decode.per_led import at_leds
from heliograph.receive.events import DecodeEvent, DetectEvent, EqualiseEvent, ExtractEvent, LostEvent, TrackEvent
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.settings import CalibrationSettings
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings
from heliograph.web.watching.patterns import encode, equalised_by, expected, grey, histograms, soft_by_layer

MAX_COLUMNS = 960  # columns of a transmitted picture

CUT_SIDE, CUT_RATIO = 72, 1.3
"""Side of a transmitted cut-out in pixels, and ratio of cut-out width to array width."""


@dataclass(frozen=True, slots=True)
class Scene:
    """Frame with boxes and cut-outs; compressed only for transmission."""

    frame: Frame
    # For each array: number, corners in px, distance in m, visibility
    boxes: list[dict[str, Any]]
    # For each array: number, and the received pattern of the newest pair
    cuts: list[dict[str, Any]]

    def encoded(self) -> bytes:
        """Return the length of the JSON text in 4 bytes (little-endian), the text, and the picture as JPEG."""
        frame = self.frame
        rows, columns = frame.pixels.shape
        pixels: Any = frame.pixels
        if columns > MAX_COLUMNS:
            size = (MAX_COLUMNS, max(1, round(rows * MAX_COLUMNS / columns)))
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        levels = np.asarray(pixels if frame.bits == 8 else pixels >> (frame.bits - 8), np.uint8)
        # quality 80 preserves the noise of the sensor
        picture = cv2.imencode(".jpg", levels, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
        head = {
            "time_s": round(frame.time_s, 6), "frame": frame.index, "width": columns, "height": rows,
            "boxes": self.boxes, "cuts": self.cuts,
        }  # fmt: skip
        text = json.dumps(head).encode()
        return len(text).to_bytes(4, "little") + text + picture


@dataclass(slots=True)
class SceneObserver:
    """Observer of the receiver that keeps the newest state for display."""

    signal: SignalSettings
    calibration: CalibrationSettings
    # Pose, and True for a visible array
    _tracked: dict[int, tuple[Pose, bool]] = field(default_factory=dict)
    _pairs: dict[int, list[ExtractEvent]] = field(default_factory=dict)
    _newest: dict[int, ExtractEvent] = field(default_factory=dict)
    _equalised: dict[int, EqualiseEvent] = field(default_factory=dict)
    _packet_rows: list[dict[str, Any]] = field(default_factory=list)
    _confirmed: set[int] = field(default_factory=set)

    def __call__(self, event: object) -> None:
        """Update the state by an event."""
        match event:
            case TrackEvent():
                self._tracked[event.identity] = event.view.pose_out(event.tracked.state.pose), event.tracked.seen
            case DetectEvent():
                self._tracked[event.detection.identity] = event.detection.fit.pose, True
            case ExtractEvent():
                pairs = self._pairs.setdefault(event.identity, [])
                pairs.append(event)
                self._newest[event.identity] = event
                del pairs[: -2 * self.signal.data_pairs]
            case EqualiseEvent():
                self._equalised[event.identity] = event
            case DecodeEvent():
                if event.packet.has_codeword:
                    self._confirmed.add(event.identity)
                self._packet_rows.append(self._packet_row(event))
                self._pairs.pop(event.identity, None)
                self._equalised.pop(event.identity, None)
            case LostEvent():
                for kept in (self._tracked, self._pairs, self._newest):
                    kept.pop(event.identity, None)

    def packet_rows(self) -> list[dict[str, Any]]:
        """Return the light of the packets decoded since the last call."""
        rows, self._packet_rows = self._packet_rows, []
        return rows

    def scene(self, frame: Frame) -> Scene:
        """Return the scene of a frame."""
        boxes = [self._box(identity, *tracked) for identity, tracked in sorted(self._tracked.items())]
        cuts = [
            {**self._name(identity), "received": self._received_frame(event)}
            for identity, event in sorted(self._newest.items())
        ]
        return Scene(frame, boxes, cuts)

    def _box(self, identity: int, pose: Pose, is_visible: bool) -> dict[str, Any]:
        unit_corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
        corners = self.signal.side / 2 * unit_corners @ pose.axes.T + np.array([pose.x, pose.y])
        return {
            **self._name(identity), "seen": is_visible, "distance_m": round(self.calibration.distance_m(pose), 2),
            "corners": [[round(float(x), 2), round(float(y), 2)] for x, y in corners],
        }  # fmt: skip

    def _name(self, identity: int) -> dict[str, Any]:
        """Return the identity of an array, marked as uncertain until a codeword of the array is decoded."""
        return {"id": identity} | ({} if identity in self._confirmed else {"uncertain": True})

    def _packet_row(self, event: DecodeEvent) -> dict[str, Any]:
        """Return a received, equalised and decided pattern of a packet, and histograms of soft values."""
        packet, form = event.packet, PacketFormat(self.signal, event.packet.format)
        row: dict[str, Any] = {"event": "light", **self._name(event.identity), "time_s": round(packet.start_time_s, 6)}
        if not packet.layers or form.single:
            return row | {"reason": packet.reason or "no inverses: the patterns depend on earlier patterns"}
        side, coded = self.signal.side, encode(form, packet.layers)
        luminances = event.luminances
        if luminances is None:
            luminances = np.stack([
                np.zeros((side, side)) if cut is None else at_leds(cut.difference, cut.corner, cut.middle, side)
                for cut in event.cutouts
            ])  # fmt: skip
        seen_pairs = np.flatnonzero(luminances.any(axis=(1, 2)))
        method, soft = "LED by LED", soft_by_layer(form, luminances)
        equalised = self._equalised.get(event.identity)
        if equalised is not None and all(equalised.llr[name].shape == soft[name].shape for name in soft):
            method = f"equalised, iteration {equalised.iteration + 1}"
            soft, luminances = equalised_by(form, equalised.llr, soft, coded)
        row |= {"how": method, "layers": histograms(soft, coded, packet.layers)}
        if not seen_pairs.size:
            return row
        pair = int(seen_pairs[len(seen_pairs) // 2])
        # if the gain is unknown, the 98th percentile stands for x' = 2
        is_calibrated = event.luminances is not None or equalised is not None
        high = 2.0 if is_calibrated else float(np.percentile(np.abs(luminances[pair]), 98)) or 1.0
        decided = expected(form, {name: np.where(bits, -1.0, 1.0) for name, bits in coded.items()})
        received = self._received_pattern(event, pair)
        return row | {
            "pair": pair + 1, "pairs": len(luminances), "equalised": grey(luminances[pair], -high, high),
            "decided": grey(decided[pair], -2.0, 2.0), **({} if received is None else {"received": received}),
        }  # fmt: skip

    def _received_pattern(self, event: DecodeEvent, pair: int) -> dict[str, Any] | None:
        """Return the camera's picture of the pattern of a pair."""
        if event.luminances is None:
            cutout = event.cutouts[pair]
            if cutout is None:
                return None
            return _cut(0.5 * (cutout.total + cutout.difference), cutout.corner, cutout.poses[0], self.signal.side)
        for extracted in self._pairs.get(event.identity, ()):
            luminances = extracted.luminances
            is_same = luminances is not None and np.array_equal(luminances, event.luminances[pair])
            if is_same or extracted.number == pair:
                return self._received_frame(extracted)
        return None

    def _received_frame(self, event: ExtractEvent) -> dict[str, Any]:
        frame = event.frames[0]
        return _cut(frame.pixels, frame.origin, event.poses[0], self.signal.side)


def _cut(pixels: Any, origin: tuple[float, float], pose: Pose, side: int) -> dict[str, Any]:
    """Return an array at a fixed size with the camera's pixels, stretched to full contrast, see `grey`."""
    width = CUT_RATIO * side * pose.pitch
    steps = (np.arange(CUT_SIDE) + 0.5) * (width / CUT_SIDE) - width / 2
    # the nearest pixel; the border of the frame is repeated
    rows, columns = (
        np.clip(np.round(middle - corner + steps).astype(np.intp), 0, count - 1)
        for middle, corner, count in zip((pose.y, pose.x), origin[::-1], pixels.shape, strict=True)
    )
    levels = np.asarray(pixels[np.ix_(rows, columns)], np.float64)
    return grey(levels, float(levels.min()), float(levels.max()))
