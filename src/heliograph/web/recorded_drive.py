"""Recorded drive of page *Watch*, which also warms up the receiver."""

import contextlib
import multiprocessing
import os
import threading
from pathlib import Path

from heliograph.base.compiled import cache_folder
from heliograph.base.errors import HeliographError
from heliograph.base.workers import begin_worker, worker_environment
from heliograph.link.settings import LinkSettings
from heliograph.media import open_film
from heliograph.probe.screens import with_receiver_for
from heliograph.receive.api import make_receiver
from heliograph.signal.settings import SignalSettings

RECORDED_DRIVE = Path(__file__).with_name("recorded-drive.mp4")
"""Film of a drive from 80 m to 25 m, simulated by `scripts/make_drive.py`, with the truth."""


def warm_up() -> bool:
    """Receive the first packet: compiled functions load before a page needs them; return True on success."""
    signal = SignalSettings()
    with contextlib.suppress(HeliographError), open_film(RECORDED_DRIVE) as film:
        settings, _ = with_receiver_for(film, signal, LinkSettings())
        receiver = make_receiver(signal, settings.receive)
        for frame in film:
            if any(packet.has_codeword for packet in receiver.push(frame)):
                return True
    return False


def start_warm_up(is_compiled: threading.Event) -> None:
    """Warm up in a thread; clear the event while the first start compiles the receiver.

    A second process compiles: pages stay responsive, and the memory of the compiler returns to the system.
    """
    done = cache_folder() / "receiver-is-compiled"
    compiler = None
    if not done.exists() and os.access(done.parent, os.W_OK):
        compiler = multiprocessing.get_context("spawn").Process(target=_compile, args=(done,), daemon=True)
        is_compiled.clear()

    def work() -> None:
        if compiler is not None:
            with contextlib.suppress(OSError), worker_environment():
                compiler.start()
            if compiler.pid is not None:
                compiler.join()
        is_compiled.set()
        if compiler is None or compiler.exitcode == 0:
            with contextlib.suppress(RuntimeError):  # the server ends
                warm_up()

    threading.Thread(target=work, daemon=True).start()


def _compile(done: Path) -> None:
    begin_worker()
    if warm_up():
        done.touch()
