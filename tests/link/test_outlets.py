"""Publishing over UDP and WebSocket."""

import json
import socket
import threading
from collections.abc import Iterator

import pytest

from heliograph.base.errors import HeliographError, MediaError, SettingsError
from heliograph.link import outlets
from heliograph.link.outlets import MOST_DATAGRAM, open_outlet

pytest.importorskip("websockets")
from waiting import HANG_S, wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from websockets.typing import Origin

ROW = {"event": "lost", "id": 3, "time_s": 1.5}


@pytest.fixture
def listener() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        one.settimeout(HANG_S)
        yield one


def test_row_is_a_datagram_with_or_without_a_listener(listener: socket.socket) -> None:
    outlet = open_outlet(f"udp://127.0.0.1:{listener.getsockname()[1]}")
    outlet.send(ROW)
    assert json.loads(listener.recv(1 << 16)) == ROW
    outlet.send({**ROW, "data": "A" * MOST_DATAGRAM})
    assert json.loads(listener.recv(1 << 16)) == {**ROW, "too_long": True}
    outlet.close()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        port = one.getsockname()[1]
    outlet = open_outlet(f"udp://127.0.0.1:{port}")
    for _ in range(3):
        outlet.send(ROW)
    outlet.close()


def test_all_clients_get_all_rows_before_the_end() -> None:
    outlet = open_outlet("ws://127.0.0.1:0")
    outlet.send(ROW)  # no client yet
    with connect(outlet.address) as first, connect(outlet.address) as second:
        for number in range(10):
            outlet.send({**ROW, "id": number})
        outlet.close()
        for client in (first, second):
            assert [json.loads(client.recv(HANG_S))["id"] for _ in range(10)] == list(range(10))
            with pytest.raises(ConnectionClosed):
                client.recv(HANG_S)
    with pytest.raises(OSError, match="refused"):
        connect(outlet.address)


def test_slow_client_is_disconnected() -> None:
    outlet = outlets.WebSocket("127.0.0.1", 0, max_waiting=1 << 16)
    with connect(outlet.address, max_queue=1, close_timeout=0.1) as client:
        for _ in range(200):  # 40 MB, unread by the client
            outlet.send({**ROW, "data": "A" * 200_000})
        with pytest.raises(ConnectionClosed):
            list(client)
    outlet.close()


def test_pages_of_other_machines_are_refused() -> None:
    outlet = open_outlet("ws://127.0.0.1:0")
    with pytest.raises(InvalidStatus):
        connect(outlet.address, origin=Origin("http://example.com"))
    with connect(outlet.address, origin=Origin("http://localhost:8000")):
        pass
    outlet.close()


def test_late_client_does_not_delay_the_end() -> None:
    before, outlet = set(threading.enumerate()), outlets.WebSocket("127.0.0.1", 0)
    for _ in range(5):
        with connect(outlet.address):
            pass
    outlet.close()
    wait_until(lambda: set(threading.enumerate()) <= before)


@pytest.mark.parametrize(("address", "error", "words"), [
    ("tcp://127.0.0.1:5000", SettingsError, "udp://HOST:PORT or ws"),
    ("udp://127.0.0.1", SettingsError, "udp://HOST:PORT or ws"),
    ("udp://127.0.0.1:70000", SettingsError, "udp://HOST:PORT or ws"),
    ("udp://127.0.0.1:0", SettingsError, "port 0, which has no listener"),
    ("nonsense", SettingsError, "udp://HOST:PORT or ws"),
    ("ws://0.0.0.0:5000", SettingsError, "only for this machine"),
    ("udp://no.such.host.invalid:5000", MediaError, "cannot send to udp://no.such"),
])  # fmt: skip
def test_invalid_addresses_are_refused(address: str, error: type[HeliographError], words: str) -> None:
    with pytest.raises(error, match=words):
        open_outlet(address)


def test_port_in_use_is_an_error() -> None:
    outlet = open_outlet("ws://127.0.0.1:0")
    with pytest.raises(MediaError, match="cannot send to ws://127"):
        open_outlet(outlet.address)
    outlet.close()
