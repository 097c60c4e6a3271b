"""What the soft receiver loses by finding pose, blur, gain and noise by itself.

    python scripts/measure_known_channel.py --distance 110 --layer low --brightness 0.7 0.8 0.9 1.0 --packets 100

Prints codewords wrong by brightness of the array, blind and with the channel known, on the same films. A loss in
brightness of 10 % is 0.9 dB where the sensor's dark noise rules and 0.5 dB where photons do.
"""

import argparse
from dataclasses import dataclass

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.statistics import Count
from heliograph.sweeps.executors import cores, each


@dataclass(frozen=True)
class Work:
    """Some packets at one brightness."""

    link: LinkSettings
    layer: str
    seeds: range
    known: bool


def measure(work: Work) -> Count:
    """Codewords wrong."""
    from heliograph.experiments.calibration.known_channel import count

    total = Count()
    for seed in work.seeds:
        one = count(work.link, seed, work.known)[work.layer]
        total.add(one.trials, one.errors)
    return total


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--distance", type=float, default=110.0)
    parser.add_argument("--layer", default="low")
    parser.add_argument("--brightness", type=float, nargs="+", default=[0.7, 0.8, 0.9, 1.0])
    parser.add_argument("--packets", type=int, default=100)
    parser.add_argument("--workers", type=int, default=cores())
    options = parser.parse_args()
    works = []
    for brightness in options.brightness:
        changes = (f"channel.distance_m={options.distance}", f"channel.arrays.0.brightness={brightness}")
        link = load_settings("static", None, ("receive.receiver=soft", *changes))
        works += [Work(link, options.layer, range(options.packets), known) for known in (False, True)]
    for work, result in zip(works, each(options.workers, measure, works), strict=True):
        low, high = result.interval()
        print(
            f"{options.distance:g} m, {options.layer}, brightness {work.link.channel.arrays[0].brightness:g}, "
            f"{'known' if work.known else 'blind'}: {result.errors} of {result.trials} wrong ({low:.2g} to {high:.2g})"
        )


if __name__ == "__main__":
    main()
