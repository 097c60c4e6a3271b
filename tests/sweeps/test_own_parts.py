"""Custom components in sweeps: in this process, in worker processes, on a Dask cluster."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import HANG_S

OWN = '''
from dataclasses import dataclass, replace

import heliograph
from heliograph.channel.motion import Drive
from heliograph.receive.packet import Packet
from heliograph.signal.code import CodePlan, CODES


@dataclass(frozen=True)
class Renaming:
    """Settings."""

    identity: int = 7


class Renamed:
    """The plain receiver; its packets get another identity."""

    def __init__(self, signal, settings, observe):
        self._plain = heliograph.make_receiver(signal, replace(settings, receiver="plain", custom={}), observe)
        self._identity = heliograph.own_settings(settings).identity

    @property
    def detections(self):
        return self._plain.detections

    def push(self, frame):
        for packet in self._plain.push(frame):
            yield replace(packet, identity=self._identity)

    def finish(self):
        for packet in self._plain.finish():
            yield replace(packet, identity=self._identity)


heliograph.register_receiver("renamed", Renamed, Renaming)
heliograph.register_motion("still", lambda drive: None)
heliograph.register_code("turbo-again", CODES["turbo"])
'''


def command(folder: Path, *options: str) -> list[str]:
    (folder / "own.py").write_text(OWN)
    few = ["--max-codewords", "1", "--set", "signal.data_pairs=8", "--set", "channel.distance_m=20"]
    few += ["--set", "channel.shake=still", "--set", "channel.duration_s=0.05"]
    load = ["-c", "from heliograph.cli.main import run; run()", "--load", str(folder / "own.py")]
    return [sys.executable, *load, "sweep", "--json", *few, *options]


def counts(folder: Path, *options: str) -> list[tuple[str, str, int, int]]:
    """Return receiver, code, and high layer codeword and error counts per point."""
    vary = ["--vary", "receiver=plain,renamed", "--vary", "signal.code=turbo,turbo-again"]
    ran = subprocess.run(command(folder, *vary, *options), cwd=folder, capture_output=True, timeout=HANG_S)
    assert not ran.returncode, ran.stderr.decode()
    return [
        (
            p["settings"]["receiver"],
            p["settings"]["signal.code"],
            *(p["layers"]["high"][k] for k in ("codewords", "codeword_errors")),
        )
        for p in json.loads(ran.stdout)
    ]


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[str, str, int, int]]:
    return counts(tmp_path_factory.mktemp("alone"), "--workers", "1")


@pytest.mark.slow
def test_a_receiver_a_code_and_a_motion_of_ones_own_in_this_process(alone: list[tuple[str, str, int, int]]) -> None:
    plain, plain_again, renamed, renamed_again = alone
    assert plain[2:] == plain_again[2:]
    assert plain[2] >= 1
    assert plain[3] == 0
    assert renamed[2:] == renamed_again[2:]
    assert renamed[3] == renamed[2] == plain[2]  # no packet from array 0 arrives


@pytest.mark.slow
def test_worker_processes_have_them_too(tmp_path: Path, alone: list[tuple[str, str, int, int]]) -> None:
    assert counts(tmp_path, "--workers", "2") == alone


@pytest.mark.slow
def test_a_cluster_has_them_too(tmp_path: Path, alone: list[tuple[str, str, int, int]]) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster:
        assert counts(tmp_path, "--scheduler", cluster.scheduler_address) == alone
