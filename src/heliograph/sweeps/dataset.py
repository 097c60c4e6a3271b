"""Sweep results as an xarray Dataset with units and provenance."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from heliograph import __version__
from heliograph.base.errors import HeliographError
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.tally import PointTally, flat_report

if TYPE_CHECKING:
    import xarray

KEY_UNITS = {
    "_px_s2": "px/s2", "_rad_s": "rad/s", "_m_s": "m/s", "_mm_h": "mm/h", "_s2": "s-2", "_m": "m", "_s": "s",
    "_px": "px", "_deg": "degree", "_rad": "rad", "_ppm": "1e-6", "_dn": "DN", "_e": "electron", "_bytes": "byte",
    "fps": "Hz",
}  # fmt: skip
"""Units by the suffix of a setting, longer suffixes first."""

COUNTS = {
    "bits": "information bits of received packets",
    "bit_errors": "wrong information bits after the turbo decoder",
    "raw_bits": "coded bits of received packets",
    "raw_errors": "wrong coded bits by the first equalisation",
    "codewords": "codewords sent",
    "codeword_errors": "wrong codewords, missed codewords included",
    "missed": "codewords of missed packets",
    "packets_read": "received packets with counted bits",
    "bit_squares": "sum of squared bit errors per packet",
    "raw_squares": "sum of squared raw errors per packet",
    "final_raw_bits": "coded bits of received packets by the last equalisation",
    "final_raw_errors": "wrong coded bits by the last equalisation",
    "final_raw_squares": "sum of squared final raw errors per packet",
}

ERROR_RATES = {
    "ber": "bit error rate after the turbo decoder",
    "raw_ber": "bit error rate before the turbo decoder, by the first equalisation",
    "final_raw_ber": "bit error rate before the turbo decoder, by the last equalisation",
    "fer": "codeword error rate",
}

POINT_VALUES = (
    ("net_bits_per_second", "bit/s", "payload of decoded codewords per time"),
    ("film_seconds", "s", "length of the films"),
    ("packets", "1", "complete packets in the films"),
    ("detected", "1", "complete packets with a detected header or decoded data"),
    ("false_codewords", "1", "accepted codewords that were not sent"),
    ("false_packets", "1", "received packets that were not sent"),
    ("duplicates", "1", "packets received again"),
    ("distance_error", "1", "relative rms error of the distance of received packets"),
    ("located", "1", "decoded packets with stated poses in space"),
    ("covered_positions", "1", "located packets with the true position in a stated 95 % region"),
    ("covered_poses", "1", "located packets with the true position and orientation in a stated 95 % region"),
    ("blocks", "1", "films counted"),
)
"""Variables of a point: name, unit and meaning."""


def need_xarray() -> None:
    """Check that xarray is installed."""
    try:
        import xarray  # noqa: F401 - availability check
    except ImportError:
        raise HeliographError("a Dataset needs xarray: pip install 'heliograph[analysis]'") from None


def unit(key: str) -> str:
    """Return the unit of a setting, "1" for a plain number."""
    return next((name for end, name in KEY_UNITS.items() if key.endswith(end)), "1")


def to_dataset(vary: Mapping[str, Sequence[Any]], tallies: Sequence[PointTally]) -> "xarray.Dataset":
    """Return a Dataset of the points of a grid with a dimension for each varied key and "layer"."""
    import xarray

    reports = [tally.report() for tally in tallies]
    layers = [[flat_report(layer) for layer in report["layers"].values()] for report in reports]
    shape = tuple(len(values) for values in vary.values())
    variables = {}
    for name, text in _layer_variables().items():
        values = np.array([[np.nan if layer[name] is None else layer[name] for layer in row] for row in layers])
        attributes = {"units": "1", "long_name": text}
        variables[name] = ((*vary, "layer"), values.reshape(*shape, len(LAYERS)), attributes)
    for name, units, text in POINT_VALUES:
        values = np.array([np.nan if report[name] is None else report[name] for report in reports])
        variables[name] = (tuple(vary), values.reshape(shape), {"units": units, "long_name": text})
    coordinates = {key: (key, _values(values), {"units": unit(key)}) for key, values in vary.items()}
    return xarray.Dataset(variables, {**coordinates, "layer": list(LAYERS)}, _provenance(vary, tallies))


def _layer_variables() -> dict[str, str]:
    """Return the meaning of each variable of a layer by name."""
    variables = dict(COUNTS)
    for name, text in ERROR_RATES.items():
        method = "Clopper-Pearson"
        if name != "fer":
            method += " at the effective number of bits, as bits of a packet fail together"
        variables[name] = text
        for end in ("low", "high"):
            variables[f"{name}_{end}"] = f"{text}, {end} end of the 95 % interval ({method})"
        variables[f"{name}_is_bound"] = f"true if no error occurred and {name}_high is an upper bound"
    return variables


def _values(values: Sequence[Any]) -> Any:
    """Return coordinates: plain numbers and texts, other values as JSON."""
    simple = all(isinstance(v, (int, float)) for v in values) or all(isinstance(v, str) for v in values)
    return np.array(values) if simple else np.array([json.dumps(v) for v in values])


def _provenance(vary: Mapping[str, Sequence[Any]], tallies: Sequence[PointTally]) -> dict[str, Any]:
    first, rule = tallies[0].point, tallies[0].rule
    shared = asdict(first.settings)
    for tally in tallies[1:]:
        shared = _common(shared, asdict(tally.point.settings))
    return {
        "title": "Error rates of an LED array to camera link",
        "source": f"heliograph {__version__}",
        "version": __version__,
        "seed": first.seed,
        "settings": json.dumps(shared),
        "vary": json.dumps({key: list(values) for key, values in vary.items()}),
        "stop": json.dumps(asdict(rule)),
        "recordings": json.dumps({name: recorded.digest for name, recorded in first.recordings.items()}),
    }


def _common(a: Any, b: Any) -> Any:
    """Return the common part of two trees."""
    return {
        key: _common(value, b[key]) if isinstance(value, Mapping) and isinstance(b[key], Mapping) else value
        for key, value in a.items()
        if key in b and (value == b[key] or (isinstance(value, Mapping) and isinstance(b[key], Mapping)))
    }
