"""Results of a sweep as an xarray Dataset with units and provenance."""

import json
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from heliograph import __version__
from heliograph.base.config import to_mapping
from heliograph.base.errors import HeliographError
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.tally import PointTally

if TYPE_CHECKING:
    import xarray

KEY_UNITS = {
    "_px_s2": "px/s2",
    "_rad_s": "rad/s",
    "_m_s": "m/s",
    "_s2": "s-2",
    "_m": "m",
    "_s": "s",
    "_px": "px",
    "_deg": "degree",
    "_rad": "rad",
    "_ppm": "1e-6",
    "_dn": "DN",
    "_e": "electron",
    "_bytes": "byte",
    "fps": "Hz",
}
"""Units by the end of a setting's name, longer ends first."""

COUNTS = {
    "bits": "information bits of received packets",
    "bit_errors": "wrong ones of them after the turbo decoder",
    "raw_bits": "coded bits of received packets",
    "raw_errors": "wrong ones of them by the first equalisation",
    "codewords": "codewords sent",
    "codeword_errors": "codewords not read rightly, missed ones included",
    "missed": "codewords of packets not received at all",
    "packets_read": "packets received whose bits are counted",
    "bit_squares": "sum of the squares of the bit errors of a packet",
    "raw_squares": "sum of the squares of the raw errors of a packet",
    "final_raw_bits": "coded bits of received packets by the last equalisation",
    "final_raw_errors": "wrong ones of them by the last equalisation",
    "final_raw_squares": "sum of the squares of the final raw errors of a packet",
}

ERROR_RATES = {
    "ber": "bit error rate after the turbo decoder",
    "raw_ber": "bit error rate before the turbo decoder, by the first equalisation",
    "final_raw_ber": "bit error rate before the turbo decoder, by the last equalisation",
    "fer": "codeword error rate",
}

INTERVAL_METHODS = {
    "ber": "Clopper-Pearson at the effective number of bits, as bits of a packet fail together",
    "raw_ber": "Clopper-Pearson at the effective number of bits, as bits of a packet fail together",
    "final_raw_ber": "Clopper-Pearson at the effective number of bits, as bits of a packet fail together",
    "fer": "Clopper-Pearson",
}


ANALYSIS = ("xarray", "pandas", "h5netcdf")
"""Packages of the extra "analysis"."""


def need_xarray() -> None:
    """Check that xarray is installed."""
    try:
        import xarray  # noqa: F401 - only whether it is there
    except ImportError:
        raise HeliographError(f"a Dataset needs xarray: pip install {' '.join(ANALYSIS)}") from None


def unit(key: str) -> str:
    """Unit of a setting by its name, "1" where it has none."""
    return next((name for end, name in KEY_UNITS.items() if key.endswith(end)), "1")


def to_dataset(vary: Mapping[str, Sequence[Any]], tallies: Sequence[PointTally]) -> "xarray.Dataset":
    """Dataset of the points of a grid: a dimension for each varied key, and "layer"."""
    import xarray

    reports = [tally.report() for tally in tallies]
    shape = tuple(len(values) for values in vary.values())
    rows = [list(report["layers"].values()) for report in reports]
    variables = {
        name: ((*vary, "layer"), values.reshape(*shape, len(LAYERS)), {"units": units, "long_name": text})
        for name, values, units, text in _by_layer(rows)
    }
    for name, units, text in _PLAIN:
        values = np.array([np.nan if r[name] is None else r[name] for r in reports]).reshape(shape)
        variables[name] = (tuple(vary), values, {"units": units, "long_name": text})
    coordinates = {key: (key, _values(values), {"units": unit(key)}) for key, values in vary.items()}
    return xarray.Dataset(variables, {**coordinates, "layer": list(LAYERS)}, _provenance(vary, tallies))


_PLAIN = (
    ("net_bits_per_second", "bit/s", "payload of codewords read, by time of film"),
    ("film_seconds", "s", "length of the films"),
    ("packets", "1", "packets filmed whole"),
    ("detected", "1", "packets of these whose header was found, or of which anything was read"),
    ("false_codewords", "1", "codewords taken for right that were not sent"),
    ("false_packets", "1", "packets received that were not sent"),
    ("duplicates", "1", "packets received again"),
    ("blocks", "1", "films counted"),
)
"""Variables of a point: name, unit and meaning."""


def _by_layer(rows: Sequence[Sequence[Mapping[str, Any]]]) -> list[tuple[str, Any, str, str]]:
    """Variables of a layer: name, values (points, layers), unit and meaning."""

    def table(pick: Any) -> Any:
        return np.array([[pick(layer) for layer in row] for row in rows])

    found = [(name, table(lambda r, n=name: r[n]), "1", text) for name, text in COUNTS.items()]
    for name, text in ERROR_RATES.items():
        rate = table(lambda r, n=name: np.nan if r[n] is None else r[n])
        found.append((name, rate, "1", text))
        for place, end in enumerate(("low", "high")):
            bound = table(lambda r, n=name, p=place: r[f"{n}_ci"][p])
            found.append(
                (f"{name}_{end}", bound, "1", f"{text}, {end} end of its 95 % interval ({INTERVAL_METHODS[name]})")
            )
        no_error = f"whether no error was met, so that {name}_high is an upper bound"
        found.append((f"{name}_is_bound", table(lambda r, n=name: r[f"{n}_is_bound"]), "1", no_error))
    return found


def _values(values: Sequence[Any]) -> Any:
    """Coordinates: numbers and texts as they are, all else as JSON."""
    simple = all(isinstance(v, (int, float)) for v in values) or all(isinstance(v, str) for v in values)
    return np.array(values) if simple else np.array([json.dumps(v) for v in values])


def _provenance(vary: Mapping[str, Sequence[Any]], tallies: Sequence[PointTally]) -> dict[str, Any]:
    first, rule = tallies[0].point, tallies[0].rule
    shared = to_mapping(first.settings)
    for tally in tallies[1:]:
        shared = _common(shared, to_mapping(tally.point.settings))
    return {
        "title": "Error rates of an LED array to camera link",
        "source": f"heliograph {__version__}",
        "version": __version__,
        "seed": first.seed,
        "settings": json.dumps(shared),
        "vary": json.dumps({key: list(values) for key, values in vary.items()}),
        "stop": json.dumps({"min_errors": rule.min_errors, "max_codewords": rule.max_codewords,
                            "max_seconds": rule.max_seconds}),
        "recordings": json.dumps({name: one.digest for name, one in first.recordings.items()}),
    }  # fmt: skip


def _common(a: Any, b: Any) -> Any:
    """The part that two trees have in common."""
    return {
        key: _common(value, b[key]) if isinstance(value, Mapping) and isinstance(b[key], Mapping) else value
        for key, value in a.items()
        if key in b and (value == b[key] or (isinstance(value, Mapping) and isinstance(b[key], Mapping)))
    }
