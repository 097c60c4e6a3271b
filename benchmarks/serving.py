"""The server of the pages under load: scenes and frames a second, beside a page that takes nothing; uploads."""

import argparse
import http.client
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any

from websockets.sync.client import ClientConnection, connect

from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages

DRIVE = ("channel.distance_m=45", "channel.duration_s=1.5")
"""The film that is watched: 1500 frames of 1024 x 512 pixels, all layers read."""

UPLOAD_BYTES = 256 << 20
"""Bytes of the upload."""

PART = 1 << 20


@contextmanager
def serving(film: Path) -> Iterator[tuple[int, int]]:
    """A server of its own process: its port, and the number of its process."""
    command = [sys.executable, "-m", "heliograph", "serve", str(film), "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        port = int(server.stdout.readline().split("127.0.0.1:")[1].split("/")[0])
        try:
            yield port, server.pid
        finally:
            server.terminate()


def processor_s(pid: int) -> float:
    """Processor time of a process so far, in s."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def opened(port: int, receiver: str, times: float | None) -> Iterator[ClientConnection]:
    """A page that watches the film."""
    with connect(f"ws://127.0.0.1:{port}/api/watch", max_size=None, compression=None, close_timeout=0.1) as socket:
        socket.send(json.dumps({"do": "speed", "times": times}))
        source = {"kind": "named", "number": 0, "receiver": receiver}
        socket.send(json.dumps({"do": "open", "source": source}))
        yield socket


def watched(port: int, receiver: str, times: float | None = None) -> dict[str, Any]:
    """What a page gets that takes all: scenes and their bytes, rows, frames, packets, seconds."""
    out = {"scenes": 0, "bytes": 0, "rows": 0, "packets": 0}
    with opened(port, receiver, times) as socket:
        began = 0.0
        for message in socket:
            began = began or time.perf_counter()
            if isinstance(message, bytes):
                out["scenes"] += 1
                out["bytes"] += len(message)
                socket.send('{"do":"took"}')
                continue
            row = json.loads(message)
            out["rows"] += 1
            socket.send(json.dumps({"do": "heard", "rows": out["rows"]}))
            out["packets"] += row["event"] == "packet"
            if row["event"] == "state":
                out["frames"] = row["frames"]
            if row["event"] in ("end", "failed"):
                return {**out, "seconds": time.perf_counter() - began}
    raise RuntimeError("the server let the page go")


@contextmanager
def beside(port: int, receiver: str, takes: bool) -> Iterator[None]:
    """Two more pages that watch the film, again and again, and take all or nothing."""
    over = threading.Event()

    def page() -> None:
        while not over.is_set():
            if takes:
                watched(port, receiver)
                continue
            with opened(port, receiver, None):
                over.wait(4.0)  # about as long as the film lasts

    pages = [threading.Thread(target=page) for _ in range(2)]
    for one in pages:
        one.start()
    time.sleep(0.5)
    try:
        yield
    finally:
        over.set()
        for one in pages:
            one.join()


def uploaded(port: int) -> float:
    """Seconds that an upload takes."""
    connection = http.client.HTTPConnection("127.0.0.1", port)
    began = time.perf_counter()
    connection.putrequest("PUT", "/api/films")
    connection.putheader("Content-Length", str(UPLOAD_BYTES))
    connection.endheaders()
    for _ in range(UPLOAD_BYTES // PART):
        connection.send(bytes(PART))
    assert connection.getresponse().status == 201
    return time.perf_counter() - began


HEAD = f"{'page':38} {'scenes':>6} {'scenes/s':>9} {'frames':>7} {'frames/s':>9} {'CPU ms/frame':>12} {'kB/scene':>9}"

CASES: tuple[tuple[str, float | None, bool | None], ...] = (
    ("alone, as fast as it goes", None, None),
    ("beside two pages that take all", None, True),
    ("beside two pages that take nothing", None, False),
    ("beside two pages that take all", None, True),
    ("beside two pages that take nothing", None, False),
    ("alone, at 1/20 of the film's time", 0.05, None),
)
"""Pages that are measured: speed, and what those beside take."""


def line(name: str, found: dict[str, Any], cpu_s: float) -> str:
    return (
        f"{name:38} {found['scenes']:6} {found['scenes'] / found['seconds']:9.1f} {found['frames']:7} "
        f"{found['frames'] / found['seconds']:9.0f} {1000 * cpu_s / found['frames']:12.2f} "
        f"{found['bytes'] / max(found['scenes'], 1) / 1e3:9.0f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--receiver", default="plain")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "drive.h5"
        settings = load_settings("paper", None, DRIVE)
        write_film(film, settings, default_messages(settings), seed=1)
        with serving(film) as (port, pid):
            watched(port, chosen.receiver)  # all is loaded
            print(HEAD)
            for name, times, takes in CASES:
                with nullcontext() if takes is None else beside(port, chosen.receiver, takes):
                    before = processor_s(pid)
                    found = watched(port, chosen.receiver, times)
                    print(line(name, found, processor_s(pid) - before), flush=True)
            seconds = uploaded(port)
            print(f"upload of {UPLOAD_BYTES / 1e6:.0f} MB: {UPLOAD_BYTES / 1e6 / seconds:.0f} MB/s")
            memory = Path(f"/proc/{pid}/status").read_text().split("VmHWM:")[1].split("kB")[0].strip()
            print(f"most memory of the server: {int(memory) / 1e3:.0f} MB")


if __name__ == "__main__":
    main()
