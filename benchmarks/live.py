"""Sustained live reception: `python -m benchmarks.live [RATE ...] [--receiver soft] [--seconds 20] [--queue-s 5]`.

For each pattern rate, a second process simulates the light and serves frames through Aravis' fake GigE Vision camera on
loopback (`examples/fake_camera.py`). This process receives the frames live. Each line lists the camera's frame rate,
frames lost in transit, skipped by the camera or dropped before the receiver, and the number of completely visible
packets decoded. Processor time covers this process: library thread, camera thread and receiver. The last column gives
the processor time for the same frames from memory. The benchmark requires libaravis-0.8.
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.frames import Frame
from heliograph.link.warm_up import warm_up
from heliograph.media import open_film
from heliograph.media.live.aravis import aravis
from heliograph.media.live.reader import LiveReader
from heliograph.receive.api import make_receiver
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

SERVER = Path(__file__).parents[1] / "examples" / "fake_camera.py"
SIDE = 128
HEAD = (
    f"{'asked':>6} {'served':>7} {'frames':>7} {'lost':>5} {'skipped':>8} {'dropped':>8} {'whole packets read':>19} "
    f"{'ms a frame':>11} {'from memory':>12}"
)


def received(frames: Iterable[Frame], signal: SignalSettings, settings: ReceiveSettings | None) -> list[Packet]:
    if settings is None:
        for _ in frames:
            pass
        return []
    receiver = make_receiver(signal, settings)
    packets = [packet for frame in frames for packet in receiver.push(frame)]
    return [*packets, *receiver.finish()]


def measured(rate: float, seconds: float, queue_s: float, settings: ReceiveSettings | None) -> str:
    signal = SignalSettings(pattern_period_s=1 / rate)
    if settings is not None:
        warm_up(signal, settings, 8)
    asked = {"rate_hz": rate, "region": f"0,0,{SIDE},{SIDE}", "duration_s": seconds, "queue_s": queue_s}
    kept: list[Frame] = []
    with open_film("camera:aravis:127.0.0.1", camera=asked) as film:
        assert isinstance(film, LiveReader)
        begun = time.process_time()
        packets = received(_kept(film, kept), signal, settings)
        live_s = time.process_time() - begun
        counts = film.counts
    assert counts is not None
    begun = time.process_time()
    received(kept, signal, settings)
    memory_s = time.process_time() - begun
    whole = [packet for packet in packets if packet.pairs_seen == 1]
    read = sum(packet.status == "ok" for packet in whole)
    return (
        f"{rate:6g} {counts.frames / seconds:7.1f} {len(kept):7d} {counts.lost + counts.incomplete:5d} "
        f"{counts.skipped:8d} {counts.dropped:8d} {f'{read}/{len(whole)}':>19} {1e3 * live_s / len(kept):11.2f} "
        f"{1e3 * memory_s / len(kept):12.2f}"
    )


def _kept(film: Iterable[Frame], kept: list[Frame]) -> Iterable[Frame]:
    for frame in film:
        kept.append(frame)
        yield frame


def main() -> None:
    parser = argparse.ArgumentParser(description="Live reception from a fake GigE Vision camera.")
    parser.add_argument("rates", nargs="*", type=float, default=[50.0, 100.0, 200.0, 300.0])
    parser.add_argument("--receiver", default="soft", help="plain, soft, or none to take frames alone")
    parser.add_argument("--seconds", type=float, default=20.0)
    parser.add_argument("--queue-s", type=float, default=5.0, help="seconds of frames that may wait")
    parser.add_argument("--lost", type=int, default=0, help="packets of UDP that are lost, of a thousand")
    arguments = parser.parse_args()
    try:
        aravis()
    except MediaError as error:
        print(f"not run: {error}")
        return
    print(f"load of the last minute {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")
    print(HEAD)
    for rate in arguments.rates:
        command = [sys.executable, str(SERVER), "--rate", str(rate), "--side", str(SIDE), "--lost", str(arguments.lost)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
            try:
                assert server.stdout is not None
                while "serving" not in (line := server.stdout.readline()):
                    assert line, "the camera could not be served"
                settings = None if arguments.receiver == "none" else ReceiveSettings(receiver=arguments.receiver)
                print(measured(rate, arguments.seconds, arguments.queue_s, settings), flush=True)
            except HeliographError as error:
                print(f"{rate:6g} {error}", flush=True)
            finally:
                server.kill()


if __name__ == "__main__":
    main()
