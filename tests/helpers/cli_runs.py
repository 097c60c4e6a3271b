"""Run the command line as users do, and check rules common to all commands."""

import contextlib
import io
import logging
import os
import re
import shlex
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import groupby
from pathlib import Path
from typing import Any

import pytest
from waiting import HANG_S, wait_until

SCRIPT = Path(sys.executable).with_name("heliograph")
COMMAND = [str(SCRIPT)] if SCRIPT.exists() else [sys.executable, "-c", "from heliograph.cli.main import run; run()"]
SMALL = (
    "--preset", "static",
    "--set", "channel.camera.width=160", "--set", "channel.camera.height=120",
    "--set", "channel.arrays.0.x_m=0", "--set", "channel.arrays.0.y_m=0",
)  # fmt: skip
"""A small camera that faces the array."""
Run = subprocess.CompletedProcess[str]
Call = Callable[..., Run]


def lasting(seconds: float) -> tuple[str, ...]:
    return (*SMALL, "--set", f"channel.duration_s={seconds}")


def heliograph(*arguments: str | Path, cwd: Path, prepare: Callable[[], object] | None = None) -> Run:
    command = [*COMMAND, *map(str, arguments)]
    options: dict[str, Any] = {"cwd": cwd, "timeout": HANG_S, "preexec_fn": prepare}
    return subprocess.run(command, capture_output=True, text=True, check=False, **options)


def _exit_code(patch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    """Run the command in this process, which saves a second of startup time."""
    from heliograph.cli.main import run

    patch.setattr(sys, "argv", ["heliograph", *map(str, arguments)])
    before, environment = signal.getsignal(signal.SIGTERM), dict(os.environ)
    try:
        with pytest.raises(SystemExit) as ended:
            run()
    finally:
        signal.signal(signal.SIGTERM, before)
        os.environ.clear()
        os.environ.update(environment)
    return int(ended.value.code or 0)


def called(*arguments: str | Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Run:
    """Run the command in the current folder."""
    capfd.readouterr()
    code = _exit_code(monkeypatch, *arguments)
    return subprocess.CompletedProcess(sys.argv, code, *capfd.readouterr())


def within(folder: Path, *arguments: str | Path) -> Run:
    """Run the command in another folder, for module-scoped fixtures."""
    out, err = io.StringIO(), io.StringIO()
    with pytest.MonkeyPatch.context() as patch, contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        patch.chdir(folder)
        code = _exit_code(patch, *arguments)
    return subprocess.CompletedProcess([*map(str, arguments)], code, out.getvalue(), err.getvalue())


STATEMENT = re.compile(r".*<<'END'\n(?:.*\n)*?END\n|.*\n")
"""A line of a script, or a text that the shell writes to a file."""


def _is_own(statement: str) -> bool:
    return statement.startswith("heliograph ") and not set("|&;$<>*") & set(statement)


def run_script(script: str) -> None:
    """Run a script of the documentation; commands of this package run in this process, which saves their start."""
    # the environment's own programs come first on the path
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    for is_own, statements in groupby(STATEMENT.findall(script.replace("\\\n", " ")), _is_own):
        for words in (shlex.split(line, comments=True) for line in statements) if is_own else ():
            run = within(Path.cwd(), *words[1:])
            logging.disable(logging.NOTSET)  # a sweep switches it off
            assert run.returncode == 0, run.stdout + run.stderr
        if not is_own:
            done = subprocess.run(
                ["sh", "-ec", "".join(statements)],
                capture_output=True, text=True, env={**os.environ, "PATH": path}, check=False,
            )  # fmt: skip
            assert done.returncode == 0, done.stdout + done.stderr


def succeeded(run: Run) -> str:
    """Check that a run succeeded with no other output than its result; return the output."""
    assert run.returncode == 0, run.stderr
    assert run.stderr == ""
    return run.stdout


def failed(run: Run, status: int = 1) -> str:
    """Check that a run failed with a one-line error message; return the message."""
    assert run.returncode == status, run.stdout + run.stderr
    assert "Traceback" not in run.stderr
    assert run.stderr.count("\n") == 1, run.stderr
    assert run.stderr.startswith("heliograph: ")
    return run.stderr.strip()


def names(folder: Path) -> list[str]:
    """List all files in a folder, hidden files included; fail on partial files."""
    found = sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if not path.is_dir())
    assert not [name for name in found if "partial" in name or Path(name).name.startswith(".")]
    return found


def interrupted(*arguments: str | Path, cwd: Path, when: Callable[[], bool]) -> Run:
    """Start a command and send SIGINT once `when` is true."""
    command = [*COMMAND, *map(str, arguments)]
    pipes: dict[str, Any] = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, cwd=cwd, preexec_fn=heed_ctrl_c, **pipes) as process:
        try:
            wait_until(lambda: when() or process.poll() is not None)
            assert process.poll() is None, "over before it could be interrupted"
            os.kill(process.pid, signal.SIGINT)
            out, err = process.communicate(timeout=HANG_S)
        finally:
            process.kill()  # an endless command would block the tests
    return subprocess.CompletedProcess(command, process.returncode, out, err)


def interrupted_at(folder: Path, *arguments: str | Path, title: str, step: float, by: int = signal.SIGINT) -> Run:
    """Run the command in this process; its progress `title` sends a signal at a step."""
    from heliograph.cli import console

    before, sent = signal.signal(signal.SIGINT, signal.default_int_handler), list[float]()

    @contextlib.contextmanager
    def progress(name: str, _: int | None, **__: bool) -> Iterator[console.Progress]:
        def advance(done: float) -> None:
            if name == title and done >= step and not sent:
                sent.append(done)
                signal.raise_signal(by)

        yield console.Progress(advance)

    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(console, "progress", progress)
            run = within(folder, *arguments)
    finally:
        signal.signal(signal.SIGINT, before)
    assert sent, f"over before step {step} of {title}"
    return run


def heed_ctrl_c() -> None:
    """Restore SIGINT, which children ignore after a shell's `&`."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def grown(folder: Path, pattern: str, size: int = 1) -> Callable[[], bool]:
    """Return a predicate: true once a file matching `pattern` has at least `size` bytes."""
    return lambda: any(path.stat().st_size >= size for path in folder.glob(pattern) if path.exists())
