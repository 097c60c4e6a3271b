"""Figures of docs/measured.md that need real recordings.

    python scripts/measure_real_input.py drives CLIP... --imu CSV
    python scripts/measure_real_input.py empty CLIP... --imu CSV [--native]
    python scripts/measure_real_input.py lossy FILM OUT

"drives": the driving trial over each clip with the recorded shake, codewords wrong of sent by distance. "empty": each
clip without any array, as the channel plays it; with --native its own frames instead, one a pattern period, resized to
the camera: nothing is faded from frame to frame and all that moves does so some forty times as fast as it did. "lossy":
a simulated film encoded again (libx264, preset medium, crf 18, yuv420p) and received, against the truth beside FILM.

Intervals are 95 % (Clopper-Pearson), "<" the bound 3/n where nothing was met. Frames go from channel to receiver
without a file, as those of a lossless film do.
"""

import argparse
from collections import deque
from collections.abc import Iterable, Iterator
from fractions import Fraction
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.channel import Truth
from heliograph.link.film import is_packet
from heliograph.link.recordings import load_footage, load_imu
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, default_messages, simulate
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.measure.reception import Reception
from heliograph.measure.statistics import Count
from heliograph.media import open_film
from heliograph.receive import Packet, make_receiver, receive_frames

REAL = ("channel.background.kind='footage'", "channel.shake='imu'")
EMPTY = ("channel.arrays=[]", "transmit.identities=[]")
CRF, PRESET = "18", "medium"


def counted(count: Count) -> str:
    """Errors of trials with their bound."""
    if count.errors:
        low, high = count.interval()
        return f"{count.errors}/{count.trials} [{low:.1e}, {high:.1e}]"
    return f"0/{count.trials} ({count.text()})"


def print_errors(errors: ErrorCounter) -> None:
    """Codewords wrong of sent, by distance and in all."""
    for start, layers in errors.bins().items():
        row = ", ".join(f"{name} {e.codeword_errors}/{e.codewords}" for name, e in layers.items())
        print(f"  {start:g}-{start + BIN_M:g} m: {row}")
    for name, e in errors.total().items():
        print(f"  {name}: {counted(e.words)} wrong, {e.missed} of them missed")
    print(f"  false codewords {errors.false_codewords}, false packets {errors.false_packets}", flush=True)


def scene(args: argparse.Namespace, clip: Path, *changes: str) -> tuple[LinkSettings, Recordings]:
    """Settings and recordings of a simulation over a clip."""
    settings = load_settings("paper", None, [*REAL, *changes, *args.set])
    return settings, Recordings(footage=load_footage(clip), imu=load_imu(args.imu))


def drives(args: argparse.Namespace) -> None:
    """The drive over real footage."""
    for clip in args.clips:
        settings, recordings = scene(args, clip)
        messages = default_messages(settings)
        errors, frames = ErrorCounter(settings, messages), Count()

        def seen(rows: Iterable[tuple[Frame, Truth]], errors: ErrorCounter, frames: Count) -> Iterator[Frame]:
            for frame, truth in rows:
                errors.saw(truth.time_s, [a.distance_m for a in truth.arrays], [a.visible for a in truth.arrays])
                frames.add(1, 0)
                yield frame

        rows = simulate(settings, messages, args.seed, recordings, args.margin)
        for packet in receive_frames(seen(rows, errors, frames), settings.signal, settings.receive):
            if is_packet(packet):
                errors.received(packet)
        print(f"{clip.name}: {frames.trials} frames")
        print_errors(errors)


def native_frames(clip: Path, settings: LinkSettings) -> Iterator[Frame]:
    """A clip's own frames, one a pattern period, of the camera's size."""
    size = settings.channel.camera.width, settings.channel.camera.height
    for index, pixels in enumerate(load_footage(clip).frames()):
        small = np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), np.uint8)
        yield Frame(index, index * settings.signal.pattern_period_s, small)


def empty(args: argparse.Namespace) -> None:
    """Clips without any array: whatever is found is false."""
    total, in_all = {name: Count() for name in ("detections", "packets", "packets with a right codeword")}, 0
    for clip in args.clips:
        settings, recordings = scene(args, clip, *EMPTY, f"channel.duration_s={args.seconds}")
        film = (frame for frame, _ in simulate(settings, [], args.seed, recordings))
        receiver, packets, frames = make_receiver(settings.signal, settings.receive), list[Packet](), 0
        for frame in islice(native_frames(clip, settings) if args.native else film, args.frames):
            packets += receiver.push(frame)
            frames += 1
        packets += receiver.finish()
        words = sum(w.status == "ok" for p in packets for layer in p.layers.values() for w in layer)
        right = sum(p.status in ("ok", "partial") for p in packets)
        found = (receiver.detections, sum(map(is_packet, packets)), right)
        for count, errors in zip(total.values(), found, strict=True):
            count.add(frames, errors)
        in_all += words
        row = ", ".join(f"{counted(Count(frames, n))} {name}" for name, n in zip(total, found, strict=True))
        print(f"{clip.name}: {row}, {words} right codewords; {len(packets) - found[1]} without header", flush=True)
    row = ", ".join(f"{counted(count)} {name}" for name, count in total.items())
    print(f"in all, a frame: {row}, {in_all} right codewords")


def encode_again(source: Path, target: Path) -> None:
    """Encode a film anew as other programs would, without its notes."""
    import av

    with open_film(source) as film, av.open(str(target), "w") as out:
        if film.width % 2 or film.height % 2:
            raise HeliographError(f"yuv420p needs an even width and height, not {film.width}x{film.height}")
        rate = Fraction(film.rate_hz).limit_denominator(1001)
        stream = out.add_stream("libx264", rate=rate, options={"crf": CRF, "preset": PRESET})
        stream.width, stream.height, stream.pix_fmt = film.width, film.height, "yuv420p"
        stream.codec_context.color_range = 2  # full, as the film's
        gray = np.full((film.height // 2, film.width), 128, np.uint8)
        for frame in film:
            luma = (frame.pixels >> (frame.bits - 8)).astype(np.uint8)
            picture = av.VideoFrame.from_ndarray(np.vstack([luma, gray]), format="yuv420p")
            picture.color_range = 2
            picture.pts, picture.time_base = frame.index, 1 / rate
            out.mux(stream.encode(picture))
        out.mux(stream.encode())


def lossy(args: argparse.Namespace) -> None:
    """A film encoded again, and what is read of it."""
    if args.film.resolve() == args.out.resolve():
        raise HeliographError("OUT must be another file than FILM")
    truth = open_truth(truth_path(args.film))
    encode_again(args.film, args.out)
    reception = Reception(truth)
    assert reception.errors is not None

    def frames(film: Iterable[Frame]) -> Iterator[Frame]:
        for frame in film:
            reception.saw(frame.index)
            yield frame

    with open_film(args.out) as film:
        for packet in receive_frames(frames(film), truth.settings.signal, truth.settings.receive):
            deque(reception.add(packet), maxlen=0)
    kilobytes = args.out.stat().st_size / 1e3 / max(reception.frames, 1)
    print(f"{args.out}: {reception.frames} frames, {kilobytes:.1f} kB a frame")
    print_errors(reception.errors)


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    top = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = top.add_subparsers(required=True)
    for name, run, seed in (("drives", drives, 1), ("empty", empty, 3)):
        command = commands.add_parser(name, help=run.__doc__)
        command.set_defaults(run=run)
        command.add_argument("clips", nargs="+", type=Path, metavar="CLIP")
        command.add_argument("--imu", type=Path, required=True, metavar="CSV", help="gyro trace of a car")
        command.add_argument("--seed", type=int, default=seed)
        command.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="change a setting")
        if run is drives:
            command.add_argument("--margin", type=int, metavar="PX", help="only the array and PX about it; else all")
        else:
            command.add_argument("--native", action="store_true", help="the clip's own frames, one a pattern period")
            command.add_argument("--seconds", type=float, default=6.7, help="length of film, unless --native")
            command.add_argument("--frames", type=int, metavar="N", help="at most N frames of each clip")
    command = commands.add_parser("lossy", help=lossy.__doc__)
    command.set_defaults(run=lossy)
    command.add_argument("film", type=Path, metavar="FILM", help="simulated film, its truth beside it")
    command.add_argument("out", type=Path, metavar="OUT")
    return top


if __name__ == "__main__":
    given = parser().parse_args()
    try:
        given.run(given)
    except HeliographError as error:
        raise SystemExit(f"measure_real_input: {error}") from None
