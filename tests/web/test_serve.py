import contextlib
import signal
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest
from cli_runs import COMMAND, within
from waiting import HANG_S
from web_server import serving

from heliograph.base.errors import SettingsError
from heliograph.cli.serve import show_address
from heliograph.web.serve import Address, open_port
from heliograph.web.shared import Limits


def test_loopback_needs_no_token() -> None:
    for host in ("127.0.0.1", "localhost", "::1"):
        address = Address(host)
        assert address.is_loopback
        assert address.access().token is None
        assert not address.access().addresses
    assert Address("::1").url(8000, None) == "http://[::1]:8000/"


def test_other_machines_need_a_new_token() -> None:
    address = Address("0.0.0.0")
    access = address.access()
    assert not address.is_loopback
    assert access.token is not None
    assert len(access.token) >= 20
    assert address.access().token != access.token
    assert access.accepts_host("192.168.7.5:8000")
    assert access.accepts_host(f"{socket.gethostname()}:8000")
    assert not access.accepts_host("evil.example:8000")
    assert address.url(8000, access.token).endswith(f":8000/#token={access.token}")
    assert address.url(8000, access.token, "receive").endswith(f":8000/receive#token={access.token}")
    assert "0.0.0.0" not in address.url(8000, access.token)
    assert Address("0.0.0.0", certificate=Path("a"), key=Path("b")).url(1, None).startswith("https://")


def test_addresses_that_cannot_be_opened_are_reported_in_a_line() -> None:
    with open_port(Address(port=0)) as taken:
        port = taken.getsockname()[1]
        said = rf"cannot listen at 127\.0\.0\.1, port {port}: .*; choose another"
        with pytest.raises(SettingsError, match=said) as error:
            open_port(Address(port=port))
    assert "\n" not in str(error.value)
    with pytest.raises(SettingsError, match=r"cannot listen at 192\.0\.2\.1"):
        open_port(Address("192.0.2.1", 0))


@pytest.mark.slow
def test_the_command_serves_until_ctrl_c() -> None:
    run = [*COMMAND, "serve", "--port", "0"]
    with subprocess.Popen(run, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as server:
        assert server.stdout is not None
        url = server.stdout.readline().split()[3]
        assert urllib.request.urlopen(f"{url}watch").status == 200
        server.send_signal(signal.SIGINT)
        out, errors = server.communicate(timeout=HANG_S)
    assert (out, errors, server.returncode) == ("ended\n", "", 0)


def test_missing_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "uvicorn", None)
    monkeypatch.delitem(sys.modules, "heliograph.web.serve", raising=False)
    assert "pip install 'heliograph[web]'" in within(tmp_path, "serve").stderr


@pytest.mark.slow
def test_idle_connections_are_closed() -> None:
    limits = Limits(idle_s=0.5, connections=4)
    with serving(limits=limits) as url, contextlib.ExitStack() as stack:
        port = int(url.rpartition(":")[2].strip("/"))
        held = [stack.enter_context(socket.create_connection(("127.0.0.1", port))) for _ in range(6)]
        held[0].sendall(b"GET /watch HTTP/1.1\r\nHost: 127.0.0.1")  # an incomplete request
        for one in held:
            one.settimeout(HANG_S)
            while one.recv(1 << 16):
                pass
        assert urllib.request.urlopen(f"{url}watch", timeout=HANG_S).status == 200


def test_address_for_other_machines_has_a_warning(capsys: pytest.CaptureFixture[str]) -> None:
    show_address("http://192.168.1.5:8000/#token=abc", is_loopback=False, is_secure=False)
    said = capsys.readouterr()
    assert "http://192.168.1.5:8000/#token=abc" in said.out
    assert "keep it to yourself" in said.err
    assert "--certificate" in said.err
