"""Tables I and II: values of the paper and of the preset "paper".

Data rates are those of the light: bits of a data pattern over time, inverses included; headers and the turbo code are
left out unless stated.
"""

from collections.abc import Callable, Sequence

from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, verdict_of
from heliograph.experiments.tracking import rates
from heliograph.link.settings import LinkSettings, load_settings

Parameter = tuple[str, float, str, Callable[[LinkSettings], float]]
"""Name, value of the paper, unit, and value of the preset in the same unit."""


def cells(parameter: Parameter, link: LinkSettings) -> list[str]:
    """Name, both values, and their agreement to 0.1 %."""
    name, paper, unit, ours = parameter
    values = (f"{value:.6g} {unit}".strip() for value in (paper, ours(link)))
    return [name, *values, "yes" if abs(ours(link) - paper) <= 1e-3 * abs(paper) else "no"]


CAMERA: tuple[Parameter, ...] = (
    ("focal length", 35.0, "mm", lambda s: 1e3 * s.channel.camera.focal_m),
    ("frame rate used, of 60 to 16000", 1000.0, "fps", lambda s: s.channel.camera.fps),
    ("pixel (FASTCAM-1280PCI)", 12.0, "um", lambda s: 1e6 * s.channel.camera.pixel_m),
)
"""Table I; the pixel is that of the camera model."""

EXPERIMENT: tuple[Parameter, ...] = (
    ("vehicle speed", 30.0, "km/h", lambda s: 3.6 * s.channel.speed_m_s),
    ("lighting frequency of the LEDs", 4.0, "kHz", lambda s: 4e-3 / s.signal.pattern_period_s),
    ("shutter speed", 1000.0, "fps", lambda s: s.channel.camera.fps),
    ("turbo code rate, high layer", 1 / 3, "", lambda s: s.signal.rate.high),
    ("turbo code rate, middle layer", 1 / 3, "", lambda s: s.signal.rate.middle),
    ("turbo code rate, low layer", 1 / 3, "", lambda s: s.signal.rate.low),
    ("focal length", 35.0, "mm", lambda s: 1e3 * s.channel.camera.focal_m),
    ("resolution, across", 1024.0, "px", lambda s: s.channel.camera.width),
    ("resolution, down", 512.0, "px", lambda s: s.channel.camera.height),
    ("distance, from", 80.0, "m", lambda s: s.channel.distance_m),
    ("distance, to", 25.0, "m", lambda s: s.channel.stop_m),
    ("LEDs in a row", 16.0, "", lambda s: s.signal.side),
    ("LED spacing", 20.0, "mm", lambda s: 1e3 * s.channel.emitter.pitch_m),
    ("half-value angle", 22.6, "deg", lambda s: s.channel.emitter.half_angle_deg),
)
"""Table II, and the data of the array from the text before it."""


def run(context: Context) -> ExperimentResult:  # noqa: ARG001 - every experiment takes a context
    """Compare the preset with the paper."""
    link = load_settings("paper")
    tables = [[cells(row, link) for row in rows] for rows in (CAMERA, EXPERIMENT)]
    camera = link.channel.camera
    fits = "yes" if camera.width <= 1280 and camera.height <= 1024 else "no"
    tables[0].append(["fits within 1280 x 1024 pixels", "yes", fits, fits])
    unset = [
        ["lens diaphragm", "11", "in the level of the light and the blur"],
        ["focus of the lens", "infinity", "in the blur"],
        ["sensor type", "CMOS", "global shutter"],
    ]
    by_tracking = [[r.method, str(r.bits), f"{r.kb_s:g}", f"{r.kb_s:g}"] for r in rates()]
    head = ["name", "paper", "preset", "equal"]
    return ExperimentResult(
        findings=[
            _agreement("Table I: the camera.", tables[0]),
            _agreement("Table II: the experiment's parameters.", tables[1]),
            *_judge_rates(link),
        ],
        tables=[
            Table("Table I", head, tables[0]),
            Table("Table II, and the array", head, tables[1]),
            Table("Values with no setting", ["name", "paper", "here"], unset),
            Table(
                "Data rate by tracking method",
                ["tracking", "bits a pattern", "bits a pattern shown", "kb/s"],
                by_tracking,
            ),
        ],
        data={"table1": tables[0], "table2": tables[1], "rates_kb_s": {r.method: r.kb_s for r in rates()}},
    )


def _judge_rates(link: LinkSettings) -> list[Finding]:
    """Compare the data rates with the paper."""
    rate, signal = net_kb_s(link), link.signal
    data_rate = rate * 2 * signal.data_pairs / signal.packet_patterns
    information = data_rate * (signal.rate.high + 2 * signal.rate.middle + signal.rate.low) / 4
    return [
        Finding(
            "Table II: 128 kb/s in the static experiment.",
            f"{signal.side**2} bits a pair, {0.5 / signal.pattern_period_s:g} pairs a second: {rate:g} kb/s; with the "
            f"headers {data_rate:.1f} kb/s, of information bits {information:.1f} kb/s.",
            verdict_of(abs(rate - 128) < 0.5),
        ),
        Finding(
            "Table II: 16 kb/s when driving.",
            f"{rate:g} kb/s: the preset's driving film carries the same signal as the static one.",
            verdict_of(abs(rate - 16) < 0.5),
            f"16 kb/s is {16 / rate:g} of this rate; the paper does not explain the difference, so the preset keeps "
            "the static rate.",
        ),
    ]


def net_kb_s(link: LinkSettings) -> float:
    """Bits of the data pairs over time in kb/s, headers and code left out."""
    return link.signal.side**2 * 0.5 / link.signal.pattern_period_s / 1000


def _agreement(claim: str, rows: Sequence[Sequence[str]]) -> Finding:
    unequal = [row[0] for row in rows if row[-1] == "no"]
    rest = f"; not: {', '.join(unequal)}." if unequal else "."
    text = f"{len(rows) - len(unequal)} of {len(rows)} values of the preset are the paper's{rest}"
    return Finding(claim, text, verdict_of(not unequal))
