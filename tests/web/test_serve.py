import contextlib
import json
import signal
import socket
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path
from typing import Any

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


def ask(url: str, method: str = "GET", **headers: str) -> tuple[int, dict[str, Any]]:
    """Return status and body of an answer; status 0 without a connection."""
    request = urllib.request.Request(url, method=method, headers={k.replace("_", "-"): v for k, v in headers.items()})
    try:
        with urllib.request.urlopen(request, timeout=HANG_S) as answer:
            return answer.status, json.load(answer)
    except urllib.error.HTTPError as error:
        return error.code, json.load(error)
    except urllib.error.URLError:
        return 0, {}


@pytest.fixture
def other_address(monkeypatch: pytest.MonkeyPatch) -> str:
    """Second loopback address in place of the address in the local network."""
    monkeypatch.setattr("heliograph.web.serve._local_address", lambda: "127.0.0.2")
    return "127.0.0.2"


def test_server_opens_to_the_network_on_request_and_closes_again(other_address: str) -> None:
    with serving() as address:
        other = address.replace("127.0.0.1", other_address)
        phone, sources = "api/transmit/phone", f"{other}api/watch/sources"
        assert ask(sources)[0] == 0
        assert ask(address + phone)[1] == {"url": "", "code": "", "opens": True}
        status, opened = ask(address + phone, "PUT")
        page, _, token = opened["url"].partition("#token=")
        assert (status, page, len(token) >= 20) == (200, f"{other}receive", True)
        assert ask(address + phone, "PUT")[1]["url"] == opened["url"]
        bearer = f"Bearer {token}"
        assert ask(sources)[0] == 401
        assert ask(sources, authorization="Bearer x")[0] == 401
        assert ask(sources, authorization=bearer, origin=address.rstrip("/"))[0] == 403
        assert ask(sources, authorization=bearer, host="evil.example")[0] == 421
        assert ask(sources, authorization=bearer)[0] == 200
        port = int(address.rpartition(":")[2].strip("/"))
        with socket.create_connection((other_address, port)) as held:
            assert ask(address + phone, "DELETE")[1]["url"] == ""
            held.settimeout(HANG_S)
            assert held.recv(1) == b""
        assert ask(sources, authorization=bearer)[0] == 0
        again = ask(address + phone, "PUT")[1]["url"]
        assert again.partition("#")[0] == page
        assert token not in again
    assert ask(sources, authorization=bearer)[0] == 0


def test_only_pages_of_this_machine_open_and_close_the_network(other_address: str) -> None:
    with serving() as address:
        phone = "api/transmit/phone"
        foreign = {"origin": f"http://{other_address}:1"}, {"sec_fetch_site": "cross-site"}, {"host": "evil.example"}
        assert [ask(address + phone, "PUT", **headers)[0] for headers in foreign] == [403, 403, 421]
        assert ask(address + phone)[1]["url"] == ""
        url = ask(address + phone, "PUT")[1]["url"]
        page, _, token = url.partition("receive#token=")
        answer = ask(page + phone, authorization=f"Bearer {token}")[1]
        assert (answer["url"], answer["opens"]) == (url, False)
        for method in ("PUT", "DELETE"):
            assert ask(page + phone, method, authorization=f"Bearer {token}")[0] == 403
        assert ask(address + phone)[1]["url"] == url


def test_machine_without_a_network_is_reported_in_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.web.serve._local_address", lambda: "127.0.0.1")
    with serving() as address:
        status, said = ask(f"{address}api/transmit/phone", "PUT")
    assert (status, said["error"][:36]) == (400, "this machine has no network address:")
