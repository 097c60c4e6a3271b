"""What a page draws at a moment: the frame, boxes about arrays, cut-outs; and a packet's light in three states."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.events import DecodeEvent, DetectEvent, EqualiseEvent, ExtractEvent, LostEvent, TrackEvent
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.settings import CalibrationSettings
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings
from heliograph.web.watching.patterns import decided, equalised_by, grey, histograms, luminances_of, soft_by_layer

WIDEST = 960
"""Most columns of a picture that is sent. Chosen: a page shows no more."""

CUT_SIDE, CUT_PITCHES = 72, 1.3
"""Rows and columns of a cut-out that is sent, and how many sides of the array it shows."""


@dataclass(frozen=True, slots=True)
class Scene:
    """A frame and what is known of it; the frame is made a picture when it is sent."""

    # The frame
    frame: Frame
    # About the arrays: number, corners in px, distance in m, whether they were in sight
    boxes: list[dict[str, Any]]
    # The newest pair of each array: number, and its pattern as received
    cuts: list[dict[str, Any]]

    def encoded(self) -> bytes:
        """The length of a text in 4 bytes, little end first; the text, JSON; the picture, JPEG."""
        frame = self.frame
        rows, columns = frame.pixels.shape
        pixels: Any = frame.pixels
        if columns > WIDEST:
            pixels = cv2.resize(pixels, (WIDEST, max(1, round(rows * WIDEST / columns))), interpolation=cv2.INTER_AREA)
        shown = np.asarray(pixels if frame.bits == 8 else pixels >> (frame.bits - 8), np.uint8)
        # Quality of a picture as JPEG, 0 to 100. Chosen by eye: noise of the sensor still shows
        picture = cv2.imencode(".jpg", shown, [cv2.IMWRITE_JPEG_QUALITY, 80])[1].tobytes()
        about = {
            "time_s": round(frame.time_s, 6), "frame": frame.index, "width": columns, "height": rows,
            "boxes": self.boxes, "cuts": self.cuts,
        }  # fmt: skip
        text = json.dumps(about).encode()
        return len(text).to_bytes(4, "little") + text + picture


@dataclass(slots=True)
class _Tracked:
    pose: Pose
    seen: bool


@dataclass(slots=True)
class Seen:
    """Observer of the receiver that keeps the newest of what a page draws."""

    # The light's signal
    signal: SignalSettings
    # Lens and array, by which a pitch is a distance
    calibration: CalibrationSettings
    _tracked: dict[int, _Tracked] = field(default_factory=dict)
    _pairs: dict[int, list[ExtractEvent]] = field(default_factory=dict)
    _llr: dict[int, EqualiseEvent] = field(default_factory=dict)
    _packets: list[dict[str, Any]] = field(default_factory=list)
    _confirmed: set[int] = field(default_factory=set)

    def __call__(self, event: object) -> None:
        """Take an event."""
        if isinstance(event, TrackEvent):
            self._tracked[event.identity] = _Tracked(event.view.pose_out(event.tracked.state.pose), event.tracked.seen)
        elif isinstance(event, DetectEvent):
            self._tracked[event.detection.identity] = _Tracked(event.detection.fit.pose, True)
        elif isinstance(event, ExtractEvent):
            kept = self._pairs.setdefault(event.identity, [])
            kept.append(event)
            del kept[: -2 * self.signal.data_pairs]
        elif isinstance(event, EqualiseEvent):
            self._llr[event.identity] = event
        elif isinstance(event, DecodeEvent):
            if event.packet.has_codeword:
                self._confirmed.add(event.identity)
            self._packets.append(self._light(event))
            self._pairs.pop(event.identity, None)
            self._llr.pop(event.identity, None)
        elif isinstance(event, LostEvent):
            self._tracked.pop(event.identity, None)
            self._pairs.pop(event.identity, None)

    def packets(self) -> list[dict[str, Any]]:
        """The light of each packet that was decoded since this was last asked for."""
        out, self._packets = self._packets, []
        return out

    def scene(self, frame: Frame) -> Scene:
        """What is drawn with a frame."""
        boxes = [self._box(identity, one) for identity, one in sorted(self._tracked.items())]
        cuts = [self._cut(identity, events[-1]) for identity, events in sorted(self._pairs.items()) if events]
        return Scene(frame, boxes, cuts)

    def _box(self, identity: int, tracked: _Tracked) -> dict[str, Any]:
        known, pose = self.calibration, tracked.pose
        reach = self.signal.side / 2
        ends = np.array([(-reach, -reach), (reach, -reach), (reach, reach), (-reach, reach)])
        corners = ends @ pose.axes.T + np.array([pose.x, pose.y])
        distance_m = known.distance_m(pose)
        return {
            **self._named(identity), "seen": tracked.seen, "distance_m": round(distance_m, 2),
            "corners": [[round(float(x), 2), round(float(y), 2)] for x, y in corners],
        }  # fmt: skip

    def _named(self, identity: int) -> dict[str, Any]:
        """The identity of an array, marked as uncertain until a codeword of the array is decoded."""
        return {"id": identity} | ({} if identity in self._confirmed else {"uncertain": True})

    def _cut(self, identity: int, event: ExtractEvent) -> dict[str, Any]:
        return {**self._named(identity), "received": received_of(event.poses[0], event.frames[0], self.signal.side)}

    def _light(self, event: DecodeEvent) -> dict[str, Any]:
        """One pair of a packet as received, as equalised and as decided; its soft values by layer."""
        packet, form = event.packet, PacketFormat(self.signal, event.packet.format)
        out: dict[str, Any] = {"event": "light", **self._named(event.identity), "time_s": round(packet.start_time_s, 6)}
        if not packet.layers or form.single:
            return out | {"reason": packet.reason or "without inverses: its patterns depend on those before"}
        if event.luminances is not None:
            luminances, how = event.luminances, "LED by LED"
            seen = np.abs(luminances).sum(axis=(1, 2)) > 0
        else:
            luminances, seen = luminances_of(event.cutouts, self.signal.side)
            how = "LED by LED"
        soft: Mapping[str, Floats] = soft_by_layer(form, luminances)
        equalised = self._llr.get(event.identity)
        if equalised is not None and all(equalised.llr[name].shape == soft[name].shape for name in soft):
            how = f"equalised, iteration {equalised.iteration + 1}"
            soft, luminances = equalised_by(form, equalised.llr, soft, packet.layers)
        out |= {"how": how, "layers": histograms(form, soft, packet.layers)}
        if not seen.any():
            return out
        places = np.flatnonzero(seen)
        place = int(places[len(places) // 2])
        high = 2.0 if event.luminances is not None or equalised is not None else _span(luminances[place])
        out |= {"pair": place + 1, "pairs": len(seen), "equalised": grey(luminances[place], -high, high)}
        shown = decided(form, packet.layers)
        if shown is not None:
            out["decided"] = grey(shown[place], -2.0, 2.0)
        received = self._received(event, place)
        return out if received is None else out | {"received": received}

    def _received(self, event: DecodeEvent, place: int) -> dict[str, Any] | None:
        """The pattern of a pair as the camera saw it."""
        if event.luminances is not None:
            for pair in self._pairs.get(event.identity, ()):
                same = pair.luminances is not None and np.array_equal(pair.luminances, event.luminances[place])
                if same or pair.number == place:
                    return received_of(pair.poses[0], pair.frames[0], self.signal.side)
            return None
        cutout = event.cutouts[place]
        if cutout is None:
            return None
        return _received_cutout(cutout, self.signal.side)


def received_of(pose: Pose, frame: AnyFrame, side: int) -> dict[str, Any]:
    """The array as the camera saw it, always as large, with the camera's own pixels, as a small picture, see `grey`."""
    return _stretched(_cut(frame.pixels, frame.origin, pose, side))


def _received_cutout(cutout: Cutout, side: int) -> dict[str, Any]:
    # sum and difference of pattern and inverse give the pattern
    return _stretched(_cut(0.5 * (cutout.total + cutout.difference), cutout.corner, cutout.poses[0], side))


def _cut(pixels: Any, origin: tuple[float, float], pose: Pose, side: int) -> Floats:
    width = CUT_PITCHES * side * pose.pitch
    steps = (np.arange(CUT_SIDE) + 0.5) * (width / CUT_SIDE) - width / 2
    # the nearest pixel; what lies beyond the frame repeats its border
    rows, columns = (
        np.clip(np.round(middle - corner + steps).astype(np.intp), 0, count - 1)
        for middle, corner, count in zip((pose.y, pose.x), origin[::-1], pixels.shape, strict=True)
    )
    return np.asarray(pixels[np.ix_(rows, columns)], np.float64)


def _stretched(pixels: Floats) -> dict[str, Any]:
    """From the darkest pixel to the brightest."""
    return grey(pixels, float(pixels.min()), float(pixels.max()))


def _span(levels: Floats) -> float:
    """What is taken for x' = 2 where the light's gain is not known."""
    return float(np.percentile(np.abs(levels), 98)) or 1.0
