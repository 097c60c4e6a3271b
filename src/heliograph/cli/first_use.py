"""Compilation on two cores at first use, as a process compiles a single function at a time."""

import contextlib
import multiprocessing
import os

import numpy as np

from heliograph.base.compiled import cache_folder
from heliograph.base.workers import begin_worker, worker_environment
from heliograph.receive.geometry.fit import Fit, fit_array
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.track.kalman import POSE, MotionModel, PoseState
from heliograph.receive.track.track import Track, preview_pair
from heliograph.signal.turbo.code import TurboCode
from heliograph.sweeps.executors import cores


def compile_ahead() -> None:
    """Compile the kernels that a reception needs last in a second process, unless they are cached or none can be."""
    folder = cache_folder()
    if cores() > 1 and os.access(folder, os.W_OK) and not any(folder.rglob("kernels.fit-*.nbi")):
        process = multiprocessing.get_context("spawn").Process(target=compile_kernels, name="compiler", daemon=True)
        with contextlib.suppress(OSError), worker_environment():
            process.start()


def compile_kernels() -> None:
    """Track an array without light, decode a codeword, and fit a pose."""
    begin_worker()
    leds, dark, covariance = np.ones((16, 16)), np.zeros((24, 24)), np.eye(5)
    pose, model = Pose(12.0, 12.0, 1.0, 0.0, 1.0), MotionModel(1e-3, 0.1)
    state = PoseState.start(0.0, pose.vector(), covariance, model).predict(1e-3, model)
    state.condition(*state.expected(POSE), POSE)
    preview_pair(Track(state, 1.0, 1.0, leds, 0.0, leds), dark, dark, (0, 0), pose)
    code = TurboCode(k=40, coded_bits=132)
    for algorithm in ("max-log", "log-map"):
        code.decode(np.ones(code.length), algorithm=algorithm, coded_output=True)
    image = 1000.0 * image_of(leds, pose, (0, 0), dark.shape)
    fit_array(image, (0, 0), Fit(pose.vector(), covariance), leds, iterations=1)
