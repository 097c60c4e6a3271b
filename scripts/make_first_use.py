"""Make the list of loops of a first use, `src/heliograph/base/first_use.txt`: `python scripts/make_first_use.py`."""

import os
import re
import subprocess
import sys
import tempfile

from heliograph.base.compile_ahead import LIST, SWITCH

USE = """
from numba.core import event

lines, depth = [], 0

class Note(event.Listener):
    def on_start(self, one):
        global depth
        function = one.data["dispatcher"].py_func
        if not depth and function.__module__.startswith("heliograph."):
            types = ", ".join(repr(kind) for kind in one.data["args"])
            lines.append(f"{function.__module__} {function.__name__} ({types},)")
        depth += 1

    def on_end(self, one):
        global depth
        depth -= 1

event.register("numba:compile", Note())

from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import make_receiver

link = load_settings("paper", None, ("channel.duration_s=0.3",))
frames = [frame for frame, _ in simulate(link, default_messages(link), 0)]
for name in ("plain", "soft"):
    settings = load_settings("paper", None, (f"receive.receiver={name}",))
    receiver = make_receiver(settings.signal, settings.receive)
    read = [packet for frame in frames for packet in receiver.push(frame)] + list(receiver.finish())
    lines.append("")
print("\\n".join(lines))
"""
"""Simulates 0.3 s and reads it by both receivers; prints what was compiled, an empty line after each receiver."""


def made() -> str:
    """Text of the list; compiles everything, which takes half a minute."""
    with tempfile.TemporaryDirectory() as folder:
        env = {**os.environ, "NUMBA_CACHE_DIR": folder, SWITCH: "0"}
        use = [sys.executable, "-c", USE]
        text = subprocess.run(use, env=env, check=True, capture_output=True, text=True).stdout
    return re.sub(r"\bbool\b", "boolean", text.strip()) + "\n"


if __name__ == "__main__":
    LIST.write_text(made(), encoding="utf-8")
    print(LIST)
