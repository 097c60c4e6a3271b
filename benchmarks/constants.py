"""What each numeric constant of the receivers is worth: codewords read with half and with twice its value.

    python -m benchmarks.constants [NAME ...] [--page docs/constants.md] [--keep results.json]

A constant is changed in a copy of the package, and the copy receives the same films as the package itself: near and
far, driving over a drawn scene, out of step, tilted, hidden and failed LEDs, without inverses, a carousel, and footage
without any array. NAME picks constants by module or name, such as `decode.layer` or `HOPELESS`; all by default, which
takes some hours of one core. With --page the table is written into a page, --keep keeps results to go on from.
"""

import argparse
import ast
import json
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import heliograph

PACKAGE = Path(heliograph.__file__).parent
ROOM = PACKAGE / "receive"

A = "channel.arrays.0."
SINGLE = "transmit.formats=[{mode='single', high='9/10', middle='3/4', low='1/2'}]"
ROAD = ("channel.background.kind=synthetic", "channel.stop_m=20")

SCENES: Mapping[str, tuple[str, Sequence[str], str, int]] = {
    "plain, 25 m": ("static", ("channel.distance_m=25",), "plain", 1),
    "plain, 62 m": ("static", ("channel.distance_m=62",), "plain", 4),
    "plain, road 75 m": ("paper", (*ROAD, "channel.distance_m=75", "channel.duration_s=0.3"), "plain", 2),
    "115 m": ("static", ("channel.distance_m=115",), "soft", 5),
    "150 m": ("static", ("channel.distance_m=152",), "soft", 4),
    "220 m": ("static", ("channel.distance_m=220",), "soft", 4),
    "road 95 m": ("paper", (*ROAD, "channel.distance_m=95", "channel.duration_s=0.3"), "soft", 2),
    "road 30 m, class D": (
        "paper", (*ROAD, "channel.distance_m=32", "channel.duration_s=0.3", "channel.road_class=D"), "soft", 1,
    ),
    "1.5 frames a pattern, 85 m": (
        "static", ("channel.distance_m=85", "channel.camera.fps=1500", "channel.camera.exposure_s=0.000666", A +
        "start_s=0.0004"), "soft", 3,
    ),
    "0.3 T_b out of step, 80 m": ("static", ("channel.distance_m=80", A + "start_s=0.0003"), "soft", 2),
    "clocks apart, frames lost, jitter, 80 m": (
        "paper",
        ("channel.distance_m=80", "channel.duration_s=0.32", "channel.camera.clock_ppm=200", A + "clock_ppm=-200",
         "channel.camera.dropped=0.02", "channel.camera.repeated=0.02", "channel.camera.jitter_s=5e-5"),
        "soft", 1,
    ),
    "tilted, 60 m": (
        "static", ("channel.distance_m=60", A + "yaw_deg=30", A + "pitch_deg=10", A + "roll_deg=5"), "soft", 2,
    ),
    "a quarter hidden, 80 m": ("static", ("channel.distance_m=80", A + "hidden=[0,0,0.5,0.5]"), "soft", 2),
    "8 % dead, 80 m": ("static", ("channel.distance_m=80", A + "dead=0.08"), "soft", 2),
    "dim, 60 m": (
        "static",
        ("channel.distance_m=60", "channel.emitter.all_on=0.08", "channel.emitter.panel_level=0",
         "channel.background.level=0"),
        "soft", 2,
    ),
    "without inverses, 85 m": (
        "paper", (SINGLE, "channel.speed_m_s=27.78", "channel.distance_m=88", "channel.stop_m=70",
                  "channel.duration_s=0.32"), "soft", 1,
    ),
    "carousel, 165 m": ("paper", ("channel.distance_m=166", "channel.duration_s=0.32"), "soft", 1),
    "no array": (
        "paper", ("channel.background.kind=synthetic", "channel.arrays=[]", "transmit.identities=[]",
                  "channel.duration_s=0.06", "channel.road_class=D"), "soft", 1,
    ),
}  # fmt: skip
"""Scenes: preset, changes, receiver, films."""


DEFINED = (
    "ERASED",
    "LEAST_DISTANCE",
    "CELL_COUNT",
    "IMAGE_COUNT",
    "PIXEL_VARIANCE_PX2",
    "PIXEL_STD_PX",
    "WALK_PATTERNS",
    "TICK",
)
"""Constants that follow from a definition: a code's distance, a count of images, a unit. They are not changed."""


@dataclass(frozen=True)
class Constant:
    """A numeric constant of a module: where it stands, its name, the span of its value and the text of it."""

    path: Path
    name: str
    start: int
    end: int
    text: str

    @property
    def key(self) -> str:
        """Module and name."""
        return ".".join([*self.path.relative_to(ROOM).with_suffix("").parts, self.name])

    def scaled(self, factor: float) -> str:
        """The value's text with every number in it scaled.

        Whole numbers stay whole and at least 1. Of numbers from 0.5 to 1.5 the distance from 1 is scaled: half of a
        score of 0.95 would be no score that anybody sets, and twice of it none at all.
        """
        tree = ast.parse(self.text, mode="eval")
        return ast.unparse(_Scaled(factor).visit(tree))


class _Scaled(ast.NodeTransformer):
    def __init__(self, factor: float):
        self._factor = factor

    def visit_Constant(self, node: ast.Constant) -> ast.Constant:
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            return node
        if isinstance(node.value, int):
            return ast.Constant(max(1, round(node.value * self._factor)) if node.value else 0)
        if 0.5 < node.value < 1.5 and node.value != 1:
            return ast.Constant(1 + (node.value - 1) * self._factor)
        return ast.Constant(node.value * self._factor)


def constants() -> Iterator[Constant]:
    """Numeric constants of the receivers' modules, those of the slow references left out."""
    for path in sorted(ROOM.rglob("*.py")):
        if path.stem == "reference":
            continue
        text = path.read_text()
        lines = [0, *(i + 1 for i, c in enumerate(text) if c == "\n")]
        for node in ast.parse(text).body:
            if not isinstance(node, ast.Assign) or not all(isinstance(t, ast.Name | ast.Tuple) for t in node.targets):
                continue
            value, name = node.value, ast.unparse(node.targets[0])
            if name.upper() != name or name.startswith(("_", "(_")) or name in DEFINED or not _numeric(value):
                continue
            start, end = (lines[row - 1] + col for row, col in (
                (value.lineno, value.col_offset), (value.end_lineno or 0, value.end_col_offset or 0)))  # fmt: skip
            yield Constant(path, name.strip("()"), start, end, text[start:end])


def _numeric(node: ast.expr) -> bool:
    """Whether an expression is made of numbers alone."""
    allowed = (ast.Constant, ast.Tuple, ast.List, ast.BinOp, ast.UnaryOp, ast.operator, ast.unaryop, ast.Load)
    if isinstance(node, ast.Call):
        return ast.unparse(node.func) in ("np.array", "np.arange") and all(map(_numeric, node.args))
    inner = [*ast.walk(node)]
    numbers = [one for one in inner if isinstance(one, ast.Constant)]
    return bool(numbers) and all(isinstance(one, allowed) for one in inner) and all(
        isinstance(one.value, int | float) for one in numbers
    )  # fmt: skip


def films(folder: Path) -> None:
    """Render all films once."""
    from heliograph.link.settings import load_settings
    from heliograph.link.simulate import simulate, transmitters
    from heliograph.measure.bench import block_settings, dithered, random_messages, window_margin_px

    for number, (preset, changes, receiver, count) in enumerate(SCENES.values()):
        for seed in range(count):
            link = dithered(block_settings(load_settings(preset, None, changes)), seed)
            messages = random_messages(link, seed)
            if "carousel" in list(SCENES)[number]:
                messages = [{name: [parts[0][:90]] for name, parts in one.items()} for one in messages]
            margin = window_margin_px(link) if link.channel.arrays else None
            frames = [frame for frame, _ in simulate(link, messages, seed, None, margin)]
            sent = {
                who: {(name, block) for packet in range(40) for name, blocks in sender.blocks(packet).items() for block
                in blocks} for who, sender in zip(link.transmit.identities, transmitters(link, messages), strict=True)
            }  # fmt: skip
            with (folder / f"{number:02}-{seed}.pkl").open("wb") as out:
                pickle.dump((number, receiver, link.signal, link.receive, frames, sent), out)


def count(folder: Path) -> dict[str, list[int]]:
    """Receive all films: by scene codewords right, codewords wrongly taken for right, and detections."""
    from heliograph.receive import make_receiver
    from heliograph.receive.events import DetectEvent

    names, found = list(SCENES), {name: [0, 0, 0] for name in SCENES}
    for path in sorted(folder.glob("*.pkl")):
        number, which, signal, settings, frames, sent = pickle.loads(path.read_bytes())
        events: list[Any] = []
        receiver = make_receiver(signal, replace(settings, receiver=which), events.append)
        packets = [packet for frame in frames for packet in receiver.push(frame)] + list(receiver.finish())
        words = [(p.identity, layer, w.block) for p in packets for layer, by in p.layers.items() for w in by if w.block]
        right = sum((layer, block) in sent.get(who, ()) for who, layer, block in words)
        detections = sum(isinstance(event, DetectEvent) for event in events)
        total = found[names[number]]
        total[0], total[1], total[2] = total[0] + right, total[1] + len(words) - right, total[2] + detections
    return found


def measure(chosen: Sequence[Constant], keep: Path | None) -> dict[str, dict[str, dict[str, list[int]] | str]]:
    """Counts by constant, for half and twice its value; what fails says how."""
    results = json.loads(keep.read_text()) if keep and keep.exists() else {}
    with tempfile.TemporaryDirectory() as place:
        folder, copy = Path(place) / "films", Path(place) / "copy" / "heliograph"
        folder.mkdir()
        films(folder)
        shutil.copytree(PACKAGE, copy, ignore=shutil.ignore_patterns("__pycache__"))
        results.setdefault("as it is", {})["1"] = _run(copy, folder)
        for constant in chosen:
            rows = results.setdefault(constant.key, {})
            for factor in ("0.5", "2"):
                if factor in rows:
                    continue
                path = copy / constant.path.relative_to(PACKAGE)
                text = path.read_text()
                path.write_text(text[: constant.start] + constant.scaled(float(factor)) + text[constant.end :])
                rows[factor] = _run(copy, folder)
                path.write_text(text)
                print(constant.key, factor, _difference(rows[factor], results["as it is"]["1"]), flush=True)
                if keep:
                    keep.write_text(json.dumps(results))
    return results


def _run(copy: Path, folder: Path) -> dict[str, list[int]] | str:
    """Counts of a copy of the package, in a process of its own; what a constant changes is compiled anew."""
    env = {**os.environ, "PYTHONPATH": os.pathsep.join([str(copy.parent), str(PACKAGE.parents[1])])}
    env |= {"OPENBLAS_NUM_THREADS": "1", "NUMBA_CACHE_DIR": str(folder.parent / "cache")}
    command = [sys.executable, "-m", "benchmarks.constants", "--count", str(folder)]
    try:
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=600, check=False)
    except subprocess.TimeoutExpired:
        return "takes more than ten times as long"
    if done.returncode:
        return (done.stderr.strip().splitlines() or ["fails"])[-1][:120]
    found: dict[str, list[int]] = json.loads(done.stdout.splitlines()[-1])
    return found


def _difference(found: dict[str, list[int]] | str, base: dict[str, list[int]]) -> str:
    """What changed, in a line."""
    if isinstance(found, str):
        return found
    total = sum(found[name][0] - base[name][0] for name in base)
    wrong = sum(found[name][1] for name in base)
    false = found["no array"][2] - base["no array"][2]
    scenes = [f"{name} {found[name][0] - base[name][0]:+d}" for name in base if found[name][0] != base[name][0]]
    parts = [(f"{total:+d}" if total else "0") + (f" ({', '.join(scenes)})" if scenes else "")]
    parts += [f"{wrong} wrong"] if wrong else []
    parts += [f"{false:+d} false detections"] if false else []
    return ", ".join(parts)


def page(results: Mapping[str, Mapping[str, dict[str, list[int]] | str]], chosen: Sequence[Constant]) -> str:
    """Text of docs/constants.md."""
    base = results["as it is"]["1"]
    assert isinstance(base, dict)
    scenes = "\n".join(f"| {name} | {right} |" for name, (right, _, _) in base.items())
    rows = "\n".join(
        f"| `{one.key}` | {one.text} | {_difference(results[one.key]['0.5'], base)} | "
        f"{_difference(results[one.key]['2'], base)} |"
        for one in chosen
        if one.key in results
    )
    return f"""# Constants

Every numeric constant of the receivers has its origin beside it in the code: an equation, an experiment, a tolerance,
or "Chosen" and what it bounds. This page lists them all. Of those that were measured it shows what they are worth: how
many codewords more or fewer are read with half and with twice the value, on the same films. Whole numbers stay whole.
Of numbers from 0.5 to 1.5 the distance from 1 is halved and doubled. 0 means that the constant is not critical on these
films: they find what a receiver cannot do without, not the last percent. The variances of the filter's observations
(`DECIDED`, `HEADER_OBSERVATION`) are not in the table. More than a third of the constants are "not measured", because
they came after the table was made. Most of these are for lost frames, posts, LED brightness, and near, turned and
passing arrays. No scene here has posts, or near, turned or passing arrays. The page is made by

<!-- skip: next "not run: takes hours, and needs the repository" -->

```sh
python -m benchmarks.constants --page docs/constants.md
```

Codewords read with all constants as they are, by scene (soft receiver where none is named), {
        sum(r for r, *_ in base.values())
    } in all:

| scene | codewords |
|---|---|
{scenes}

Codewords read more or fewer:

| constant | value | half | twice |
|---|---|---|---|
{rows}
"""


def main() -> None:
    """Measure what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("name", nargs="*")
    parser.add_argument("--page", type=Path)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--count", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--list", action="store_true", help="list the constants and do nothing")
    given = parser.parse_args()
    if given.count:
        print(json.dumps(count(given.count)))
        return
    chosen = [one for one in constants() if not given.name or any(name in one.key for name in given.name)]
    if given.list:
        for one in chosen:
            print(one.key, one.text)
        return
    results = measure(chosen, given.keep)
    if given.page:
        given.page.write_text(page(results, chosen))


if __name__ == "__main__":
    main()
