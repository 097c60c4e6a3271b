"""Tables I and II: the paper's values beside the preset's, and the data rate of each way of tracking."""

from collections.abc import Callable
from dataclasses import dataclass

from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.experiments.tracking.experiment import rates
from heliograph.link.settings import LinkSettings, load_settings

TEXT = (
    'Each value of the paper\'s tables beside that of the preset "paper", compared in code. Data rates are those of '
    "the light: bits of a data pattern by time, an inverse counted as time; headers and the turbo code left out unless "
    "said."
)


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter of the paper beside the preset's."""

    # Name of the parameter in the tables
    name: str
    # The paper's value in `unit`; a text is compared as it is
    paper: float | str
    # Unit of the value; empty where it has none
    unit: str
    # Takes the value, in the same unit, from the settings
    of: Callable[[LinkSettings], float | str]

    def ours(self, link: LinkSettings) -> float | str:
        """The preset's value."""
        return self.of(link)

    def equal(self, link: LinkSettings) -> bool:
        """Whether they agree, numbers to 0.1 %."""
        ours = self.ours(link)
        if isinstance(ours, str) or isinstance(self.paper, str):
            return ours == self.paper
        return abs(ours - self.paper) <= 1e-3 * abs(self.paper)

    def cells(self, link: LinkSettings) -> list[str]:
        """Name, both values, and whether they agree."""
        values = [
            f"{v if isinstance(v, str) else f'{v:.6g}'} {self.unit}".strip() for v in (self.paper, self.ours(link))
        ]
        return [self.name, *values, "yes" if self.equal(link) else "no"]


CAMERA = (
    Parameter("focal length", 35.0, "mm", lambda s: 1e3 * s.channel.camera.focal_m),
    Parameter("frame rate used, of 60 to 16000", 1000.0, "fps", lambda s: s.channel.camera.fps),
    Parameter("pixel (FASTCAM-1280PCI)", 12.0, "um", lambda s: 1e6 * s.channel.camera.pixel_m),
    Parameter("fits within 1280 x 1024 pixels", "yes", "", lambda s: "yes" if _fits(s) else "no"),
)
"""Table I; the pixel is the model's."""

EXPERIMENT = (
    Parameter("vehicle speed", 30.0, "km/h", lambda s: 3.6 * s.channel.speed_m_s),
    Parameter("lighting frequency of the LEDs", 4.0, "kHz", lambda s: 4e-3 / s.signal.pattern_period_s),
    Parameter("shutter speed", 1000.0, "fps", lambda s: s.channel.camera.fps),
    Parameter("turbo code rate, high layer", 1 / 3, "", lambda s: s.signal.rate.high),
    Parameter("turbo code rate, middle layer", 1 / 3, "", lambda s: s.signal.rate.middle),
    Parameter("turbo code rate, low layer", 1 / 3, "", lambda s: s.signal.rate.low),
    Parameter("focal length", 35.0, "mm", lambda s: 1e3 * s.channel.camera.focal_m),
    Parameter("resolution, across", 1024.0, "px", lambda s: float(s.channel.camera.width)),
    Parameter("resolution, down", 512.0, "px", lambda s: float(s.channel.camera.height)),
    Parameter("distance, from", 80.0, "m", lambda s: s.channel.distance_m),
    Parameter("distance, to", 25.0, "m", lambda s: s.channel.stop_m),
    Parameter("LEDs in a row", 16.0, "", lambda s: float(s.signal.side)),
    Parameter("LED spacing", 20.0, "mm", lambda s: 1e3 * s.channel.emitter.pitch_m),
    Parameter("half-value angle", 22.6, "deg", lambda s: s.channel.emitter.half_angle_deg),
)
"""Table II, and the array's data from the text before it."""

UNSAID = (
    ["lens diaphragm", "11", "in the level of the light and the blur"],
    ["focus of the lens", "infinity", "in the blur"],
    ["sensor type", "CMOS", "global shutter"],
)

STATIC_KB_S, DRIVING_KB_S = 128.0, 16.0


def run(context: Context) -> ExperimentResult:  # noqa: ARG001 - every experiment takes a context
    """Compare."""
    link, by_tracking = load_settings("paper"), rates()
    return ExperimentResult(
        key="tables",
        title="Tables I and II, data rates",
        text=TEXT,
        findings=judge(link),
        tables=[
            *(
                _table(title, rows, link)
                for title, rows in (("Table I", CAMERA), ("Table II, and the array", EXPERIMENT))
            ),
            Table("Without a setting of their own", ["name", "paper", "here"], UNSAID),
            Table(
                "Data rate by way of tracking",
                ["tracking", "bits a pattern", "bits a pattern shown", "kb/s"],
                [[r.method, str(r.bits), f"{r.per_slot:g}", f"{r.kb_s:g}"] for r in by_tracking],
            ),
        ],
        data={
            "table1": [row.cells(link) for row in CAMERA],
            "table2": [row.cells(link) for row in EXPERIMENT],
            "rates_kb_s": {r.method: r.kb_s for r in by_tracking},
        },
    )


def judge(link: LinkSettings) -> list[Finding]:
    """Whether parameters and data rates are the paper's."""
    rate = net_kb_s(link)
    return [
        _agreement("Table I: the camera.", CAMERA, link),
        _agreement("Table II: the experiment's parameters.", EXPERIMENT, link),
        Finding(
            "Table II: 128 kb/s in the static experiment.",
            f"{link.signal.side**2} bits a pair, {_pairs_a_second(link):g} pairs a second: {rate:g} kb/s; with the "
            f"headers {rate * _data_fraction(link):.1f} kb/s, of information bits {_information_kb_s(link):.1f} kb/s.",
            "holds" if abs(rate - STATIC_KB_S) < 0.5 else "differs",
        ),
        Finding(
            "Table II: 16 kb/s when driving.",
            f"{rate:g} kb/s: the preset's driving film carries the same signal as the static one.",
            "holds" if abs(rate - DRIVING_KB_S) < 0.5 else "differs",
            f"16 kb/s is {DRIVING_KB_S / rate:g} of it; the paper does not say where the rest goes, so the preset "
            "does not leave it out.",
        ),
    ]


def net_kb_s(link: LinkSettings) -> float:
    """Bits of the data pairs by time in kb/s, headers and code left out."""
    return link.signal.side**2 * _pairs_a_second(link) / 1000


def _pairs_a_second(link: LinkSettings) -> float:
    return 0.5 / link.signal.pattern_period_s


def _data_fraction(link: LinkSettings) -> float:
    return 2 * link.signal.data_pairs / link.signal.packet_patterns


def _information_kb_s(link: LinkSettings) -> float:
    rate = link.signal.rate
    return net_kb_s(link) * _data_fraction(link) * (rate.high + 2 * rate.middle + rate.low) / 4


def _fits(link: LinkSettings) -> bool:
    return link.channel.camera.width <= 1280 and link.channel.camera.height <= 1024


def _agreement(claim: str, rows: tuple[Parameter, ...], link: LinkSettings) -> Finding:
    off = [row.name for row in rows if not row.equal(link)]
    text = f"{len(rows) - len(off)} of {len(rows)} values of the preset are the paper's" + (
        f"; not: {', '.join(off)}." if off else "."
    )
    return Finding(claim, text, "differs" if off else "holds")


def _table(title: str, rows: tuple[Parameter, ...], link: LinkSettings) -> Table:
    return Table(title, ["name", "paper", "preset", "equal"], [row.cells(link) for row in rows])
