"""Codewords that builds of the package read from the same films, and how long they take.

    python -m benchmarks.fixed_seeds NAME=PYTHON ... [--films 4]

Each build is named and given by the interpreter of its virtual environment. Each simulates the same films by the same
seeds, six packets each, and receives them, one core, in turn. Prints a table in Markdown: wrong codewords of sent
(high, middle, low), and the ratio of the time of receiving to the first build's. Films that differ are an error.
"""

import argparse
import json
import os
import subprocess
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

ARRAY = "channel.arrays.0."
HIDDEN = f"{ARRAY}hidden=[0,0,0.5,0.5]"
SINGLE = "transmit.formats=[{mode='single', high='9/10', middle='3/4', low='1/2'}]"
FASTER = ("channel.camera.fps=1500", "channel.camera.exposure_s=0.000666", f"{ARRAY}start_s=0.0004")
DRIVE = ("channel.camera.width=512", "channel.camera.height=320", f"{ARRAY}x_m=0.5", f"{ARRAY}y_m=0")
SMALL = ("channel.camera.width=256", "channel.camera.height=128", f"{ARRAY}y_m=0", "channel.duration_s=0.62")

SCENES: Mapping[str, tuple[str, Sequence[str], Sequence[str]]] = {
    "at rest, 60 m": ("static", (*SMALL, "channel.distance_m=60"), ("plain", "soft")),
    "at rest, 105 m": ("static", (*SMALL, "channel.distance_m=105"), ("plain", "soft")),
    "at rest, 150 m": ("static", (*SMALL, "channel.distance_m=150"), ("plain", "soft")),
    "at rest, 220 m": ("static", (*SMALL, "channel.distance_m=220"), ("plain", "soft")),
    "drive, 80 m to 25 m": ("paper", DRIVE, ("plain", "soft")),
    "1500 frames/s, 80 m": ("static", (*SMALL, "channel.distance_m=80", *FASTER), ("soft",)),
    "a quarter hidden, 50 m": ("static", (*SMALL, "channel.distance_m=50", HIDDEN), ("plain", "soft")),
    "a quarter hidden, 80 m": ("static", (*SMALL, "channel.distance_m=80", HIDDEN), ("plain", "soft")),
    "single mode, 85 m on, 100 km/h": (
        "paper", (*DRIVE, SINGLE, "channel.speed_m_s=27.78", "channel.distance_m=85", "channel.duration_s=0.62"),
        ("soft",),
    ),
}  # fmt: skip
"""Scenes: preset, changes, receivers that apply."""

DIGEST = """
import hashlib, sys
from heliograph import open_film
digest = hashlib.sha256()
with open_film(sys.argv[1]) as film:
    for frame in film:
        digest.update(frame.pixels.tobytes())
print(digest.hexdigest())
"""


def run(python: str, program: str, arguments: Sequence[str]) -> str:
    """Run a program with a build on one core; return what it prints."""
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": ""}
    command = [python, "-c", program, *arguments]
    ran = subprocess.run(command, env=environment, cwd="/", capture_output=True, text=True, check=False)
    if ran.returncode:
        raise SystemExit(f"{python} {' '.join(arguments)}: {ran.stderr.strip()}")
    return ran.stdout


def films(folder: Path, python: str, scene: str, count: int) -> list[str]:
    """Simulate a scene's films with a build, each with the array elsewhere within a pixel; return their digests."""
    preset, changes, _ = SCENES[scene]
    digests = []
    for seed in range(1 if scene.startswith("drive") else count):
        film = str(folder / f"{seed}.h5")
        given = ["simulate", film, "--preset", preset, "--seed", str(seed)]
        for change in (*changes, *([] if "drive" in scene else [f"{ARRAY}x_m={0.1 + 0.0111 * seed}"])):
            given += ["--set", change]
        run(python, "from heliograph.cli.main import run; run()", given)
        digests.append(run(python, DIGEST, [film]))
    return digests


def count(folder: Path, python: str, receiver: str) -> tuple[str, float]:
    """Receive a folder of films with a build: wrong codewords of sent by layer, and the seconds of receiving.

    Programs start and compile outside these seconds.
    """
    wrong, sent, took = Counter[str](), Counter[str](), 0.0
    for film in sorted(folder.glob("*.h5")):
        given = ["receive", str(film), "--truth", f"{film}.truth.npz", "--receiver", receiver, "--json"]
        report = json.loads(run(python, "from heliograph.cli.main import run; run()", given))
        took += report["seconds"]
        for row in report["errors"]:
            for layer in ("high", "middle", "low"):
                wrong[layer] += row[layer]["codeword_errors"]
                sent[layer] += row[layer]["codewords"]
    return ", ".join(f"{wrong[layer]}/{sent[layer]}" for layer in sent), took


def main() -> None:
    """Compare the builds that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", nargs="+", metavar="NAME=PYTHON")
    parser.add_argument("--films", type=int, default=4)
    given = parser.parse_args()
    builds = dict(one.split("=", 1) for one in given.build)
    print("| scene | receiver |", *(f"{name} |" for name in builds), *(f"time, {name} |" for name in [*builds][1:]))
    print("|---|---|" + "---|" * (2 * len(builds) - 1))
    for scene, (_, _, receivers) in SCENES.items():
        with tempfile.TemporaryDirectory() as place:
            folders = {name: Path(place) / name for name in builds}
            for folder in folders.values():
                folder.mkdir()
            digests = {tuple(films(folders[name], python, scene, given.films)) for name, python in builds.items()}
            if len(digests) > 1:
                raise SystemExit(f"{scene}: the builds' films differ")
            for receiver in receivers:
                found = [count(folders[name], python, receiver) for name, python in builds.items()]
                ratios = [f"{took / found[0][1]:.2f} |" for _, took in found[1:]]
                print(f"| {scene} | {receiver} |", *(f"{counts} |" for counts, _ in found), *ratios, flush=True)


if __name__ == "__main__":
    main()
