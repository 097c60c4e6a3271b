"""Simulate a GigE Vision camera on loopback: Aravis' fake camera filming a simulated light.

Run the camera in one shell and receive in another:

    python examples/fake_camera.py
    heliograph receive camera:aravis --receiver soft --set signal.pattern_period_s=0.01 --duration 10

The camera serves frames from `heliograph.simulate` through the GigE Vision protocol: discovery, control, UDP packets,
timestamps and frame numbers. Exposures start at multiples of the frame period, and the light continues between
frames. The script requires libaravis-0.8 (Debian: apt-get install libaravis-0.8-0).
"""

import argparse
import contextlib
import ctypes
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

import heliograph

PHASES = 8
"""Simulated phases per pattern; frame timing is accurate to a sixteenth of a pattern."""

FILL = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32)
"""Frame callback: buffer to fill, user data, exposure, gain and pixel format."""


def link(period_s: float, phase: int, packets: int, arguments: argparse.Namespace) -> heliograph.LinkSettings:
    """Return settings for an array at rest, `phase` eighths of a pattern out of step with the camera."""
    signal = heliograph.SignalSettings(pattern_period_s=period_s, data_pairs=arguments.data_pairs)
    changes = {
        "signal.pattern_period_s": period_s,
        "signal.data_pairs": arguments.data_pairs,
        "channel.distance_m": arguments.distance,
        "channel.duration_s": packets * signal.packet_s + 2 * period_s,
        "channel.camera.fps": 1 / period_s,
        "channel.camera.exposure_s": period_s,
        "channel.camera.start_s": phase * period_s / PHASES,
        "channel.camera.width": arguments.side,
        "channel.camera.height": arguments.side,
        "channel.arrays.0.x_m": 0,
        "channel.arrays.0.y_m": 0,
    }
    return heliograph.load_settings("static", None, [f"{key}={value}" for key, value in changes.items()])


def filmed(period_s: float, packets: int, arguments: argparse.Namespace) -> NDArray[np.uint8]:
    """Simulate all phases of all patterns, (patterns * PHASES, rows, columns)."""
    films = []
    for phase in range(PHASES):
        settings = link(period_s, phase, packets, arguments)
        frames = heliograph.simulate(settings, [{"high": [arguments.text.encode()]}], seed=phase)
        films.append(np.array([frame.pixels for frame, _ in frames]))
    patterns = packets * settings.signal.packet_patterns
    return np.stack([film[:patterns] for film in films], axis=1).reshape(-1, arguments.side, arguments.side)


def aravis() -> Any:
    """Load libaravis and declare the functions used here."""
    library = ctypes.CDLL("libaravis-0.8.so.0")
    pointer, text = ctypes.c_void_p, ctypes.c_char_p
    for name, result, *taken in (
        ("arv_gv_fake_camera_new", pointer, text, text),
        ("arv_gv_fake_camera_get_fake_camera", pointer, pointer),
        ("arv_gv_fake_camera_is_running", ctypes.c_int, pointer),
        ("arv_fake_camera_set_fill_pattern", None, pointer, FILL, pointer),
        ("arv_fake_camera_write_register", ctypes.c_int, pointer, ctypes.c_uint32, ctypes.c_uint32),
        ("arv_fake_camera_read_register", ctypes.c_int, pointer, ctypes.c_uint32, ctypes.POINTER(ctypes.c_uint32)),
        ("arv_buffer_set_timestamp", None, pointer, ctypes.c_uint64),
        ("arv_fake_camera_get_payload", ctypes.c_size_t, pointer),
        ("arv_buffer_get_data", pointer, pointer, pointer),
        ("g_object_set", None, pointer, text, ctypes.c_double, pointer),
        ("g_object_unref", None, pointer),
    ):  # fmt: skip
        call = getattr(library, name)
        call.restype, call.argtypes = result, taken
    return library


WIDTH, HEIGHT, FRAME_PERIOD = 0x100, 0x104, 0x138
"""Fake camera registers: frame columns, frame rows, and frame period in us."""


def serve(film: NDArray[np.uint8], period_s: float, arguments: argparse.Namespace) -> int:
    """Serve frames until timeout or Ctrl-C; return the number of frames requested."""
    library, served, last_ns = aravis(), 0, time.time_ns()
    frame_us = ctypes.c_uint32()

    @FILL
    def fill(buffer: int, _data: int, _exposure: int, _gain: int, _format: int) -> None:
        nonlocal served, last_ns
        library.arv_fake_camera_read_register(inside, FRAME_PERIOD, ctypes.byref(frame_us))
        step_ns = 1000 * frame_us.value
        # the camera's clock counts frames: on a busy machine it is slow instead of skipping frames
        exposed_ns = last_ns = last_ns // step_ns * step_ns + step_ns
        picture = film[round((exposed_ns * 1e-9 / period_s + arguments.phase) * PHASES) % len(film)]
        room = library.arv_fake_camera_get_payload(inside)
        into = library.arv_buffer_get_data(buffer, None)
        ctypes.memmove(into, picture.ctypes.data, min(room, picture.nbytes))
        library.arv_buffer_set_timestamp(buffer, exposed_ns)
        served += 1

    camera = library.arv_gv_fake_camera_new(arguments.interface.encode(), arguments.serial.encode())
    if not camera or not library.arv_gv_fake_camera_is_running(camera):
        raise SystemExit(f"no camera can be served on {arguments.interface}: is another one running there?")
    inside = library.arv_gv_fake_camera_get_fake_camera(camera)
    for register, value in ((WIDTH, arguments.side), (HEIGHT, arguments.side), (FRAME_PERIOD, round(1e6 * period_s))):
        library.arv_fake_camera_write_register(inside, register, value)
    library.g_object_set(camera, b"gvsp-lost-ratio", arguments.lost / 1000, None)
    library.arv_fake_camera_set_fill_pattern(inside, fill, None)
    print(f"serving camera:aravis:Aravis-Fake-{arguments.serial}", flush=True)
    with contextlib.suppress(KeyboardInterrupt):
        time.sleep(arguments.seconds)
    library.g_object_unref(camera)
    return served


def main() -> None:
    """Simulate the light, then serve it."""
    parser = argparse.ArgumentParser(description="Serve a simulated light by Aravis' fake GigE Vision camera.")
    parser.add_argument("--rate", type=float, default=100.0, help="patterns a second that the light shows")
    parser.add_argument("--distance", type=float, default=20.0, help="distance of the array in m")
    parser.add_argument("--side", type=int, default=128, help="pixels along a side of the frames")
    parser.add_argument("--data-pairs", type=int, default=48, help="pairs of data in a packet")
    parser.add_argument("--text", default="Red for 12 s.", help="message of the high layer")
    parser.add_argument("--packets", type=int, default=4, help="packets that are filmed, and then shown again")
    parser.add_argument("--interface", default="127.0.0.1", help="address at which the camera listens")
    parser.add_argument("--serial", default="GV01", help="serial number of the camera")
    parser.add_argument("--lost", type=int, default=0, help="packets of UDP that are lost, of a thousand")
    parser.add_argument("--seconds", type=float, default=3600.0, help="how long it serves")
    parser.add_argument("--phase", type=float, default=0.0, help="patterns by which the camera is out of step")
    arguments = parser.parse_args()
    period_s = 1 / arguments.rate
    film = filmed(period_s, arguments.packets, arguments)
    print(f"{len(film)} frames of {arguments.side}x{arguments.side} pixels simulated", flush=True)
    print(f"{serve(film, period_s, arguments)} frames served")


if __name__ == "__main__":
    main()
