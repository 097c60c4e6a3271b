"""Rows of a reception for display: the source, and the counts."""

from typing import TYPE_CHECKING, Any

from heliograph.measure.errors import ErrorCounter
from heliograph.measure.journal import Row
from heliograph.measure.reception import ReceptionCounter
from heliograph.measure.statistics import clopper_pearson
from heliograph.media import FilmReader
from heliograph.signal.settings import LAYERS, SignalSettings

if TYPE_CHECKING:  # the pages take the extra web
    from heliograph.web.watching.sources import Source


def source_row(
    film: "FilmReader | Source",
    name: str,
    signal: SignalSettings,
    receiver: str,
    *,
    is_live: bool = False,
    has_truth: bool = False,
) -> Row:
    """Return the source of a reception."""
    return {
        "event": "source", "name": name, "width": film.width, "height": film.height, "rate_hz": film.rate_hz,
        "frames": film.frame_count, "receiver": receiver, "packet_s": signal.packet_s, "side": signal.side,
        "live": is_live, "truth": has_truth,
    }  # fmt: skip


def state_row(reception: ReceptionCounter, time_s: float) -> dict[str, Any]:
    """Return the counts of a reception at the time of a frame."""
    row: dict[str, Any] = {
        "event": "state",
        "frames": reception.frames,
        "time_s": round(time_s, 6),
        "detections": reception.detections,
        "left_out": {"candidates": reception.left_out.dropped, "blocks": reception.left_out.blocks},
        "arrays": reception.report(1.0)["arrays"],
    }
    if reception.errors is not None:
        row |= {"errors": errors_by_distance(reception.errors), "false_codewords": reception.errors.false_codewords}
    return row


def errors_by_distance(errors: ErrorCounter) -> list[dict[str, Any]]:
    """Return wrong and sent codewords by distance and layer, with the 95 % interval of the error rate."""
    rows = []
    for row in errors.report():
        layers = {}
        for name in LAYERS:
            wrong, sent = row[name]["codeword_errors"], row[name]["codewords"]
            low, high = clopper_pearson(wrong, sent) if sent else (0.0, 1.0)
            bits = {"raw_wrong": row[name]["raw_errors"], "raw_bits": row[name]["raw_bits"]}
            layers[name] = {"wrong": wrong, "sent": sent, "low": low, "high": high, **bits}
        rows.append({"from_m": row["from_m"], "to_m": row["to_m"], "layers": layers})
    return rows
