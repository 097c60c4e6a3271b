"""Web server of the pages."""

import contextlib
import sys
import webbrowser
from dataclasses import astuple
from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.errors import MediaError, SettingsError
from heliograph.cli import console, options
from heliograph.cli.options import option
from heliograph.media import open_film
from heliograph.media.images import is_pattern
from heliograph.media.live.reader import film_path, is_camera
from heliograph.media.live.settings import camera_settings


@options.command
def serve(
    films: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FILM]...", parser=film_path, help=f"Films for page Watch. {options.FILM_KINDS}"),
    ] = None,
    *,
    address: options.AddressOptions,
    browse: bool = option("Open the pages in this machine's browser.", None, "--open", default=False),
    camera: options.CameraOption = None,
    receiver: options.Receiver = None,
    settings: options.SettingsOptions,
) -> None:
    """Serve pages to watch a receiver, transmit and receive.

    Watch the receiver, transmit by a screen, receive by the camera of a phone.

    By default only this machine has access. With --host, an address with a token is printed, on a terminal also as a
    QR code. Uploaded films are deleted when the server ends. Ctrl-C ends the server.
    """
    if (address.certificate is None) != (address.key is None):
        raise SettingsError("HTTPS requires both --certificate and --key")
    for film in films or ():
        if not (is_camera(film) or is_pattern(film) or film.exists()):
            raise MediaError(f"there is no file {film}: check the name")
        if not is_camera(film):
            # report unreadable films now; pages can set another frame rate
            open_film(film, rate_hz=1.0).close()
    is_auto = settings.is_auto(receiver)
    link = settings.changed(overrides=options.DetectOptions(receiver).assignments()).load()
    camera_settings(camera or ())
    try:
        from heliograph.web.app import create_app
        from heliograph.web.serve import Address, open_port, run
        from heliograph.web.shared import Limits
    except ImportError as error:
        raise MediaError(f"the pages require the extra 'web' ({error.name}): pip install 'heliograph[web]'") from None
    served, limits = Address(*astuple(address)), Limits()
    access = served.access()
    with open_port(served) as listener:
        url = served.url(listener.getsockname()[1], access.token)
        phone_url = "" if served.is_loopback else served.url(listener.getsockname()[1], access.token, "receive")
        shown = [str(film) for film in films or ()]
        app = create_app(link, shown, access, limits, camera or (), is_auto=is_auto, phone_url=phone_url)
        show_address(url, is_loopback=served.is_loopback, is_secure=served.is_secure)
        if browse:
            webbrowser.open(url)
        with contextlib.suppress(KeyboardInterrupt):
            run(app, listener, served, limits)
    console.say("ended")


def show_address(url: str, *, is_loopback: bool, is_secure: bool) -> None:
    """Print the address of the pages; for other machines also a QR code and warnings."""
    console.say(f"Heliograph is at {url}  (Ctrl-C ends it)")
    if is_loopback:
        return
    if sys.stdout.isatty():
        import segno

        segno.make(url, error="l").terminal(compact=True)
    console.complain("everyone with this address has access to this server: keep it to yourself")
    if not is_secure:
        console.complain(
            "without --certificate and --key browsers give these pages no access to the camera; films can be uploaded"
        )
