"""A server of the pages in a thread of this process, so that tests can inject faults."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from film_checks import uniform, write_levels
from waiting import wait_until

from heliograph.web.app import create_app
from heliograph.web.security import Access
from heliograph.web.serve import Address, make_server, open_port
from heliograph.web.shared import Limits

OWN = "http://127.0.0.1:8000"  # address of test clients; other addresses are rejected


@contextmanager
def serving(
    films: Sequence[Path] = (), limits: Limits | None = None, access: Access | None = None, phone_url: str = ""
) -> Iterator[str]:
    address, limits = Address(port=0), limits or Limits()
    app = create_app(films=[str(film) for film in films], access=access, limits=limits, phone_url=phone_url)
    with open_port(address) as listener:
        server = make_server(app, listener, address, limits)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            wait_until(lambda: server.started)
            yield f"http://127.0.0.1:{listener.getsockname()[1]}/"
        finally:
            server.should_exit = True
            thread.join()


def write_dark_film(path: Path, frames: int = 40) -> Path:
    return write_levels(path, uniform(20 + np.arange(frames) % 2, 48, 64))
