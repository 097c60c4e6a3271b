"""Web server of the pages."""

import contextlib
import sys
import webbrowser
from pathlib import Path

from heliograph.base.errors import MediaError, SettingsError
from heliograph.cli import console
from heliograph.cli.options import AddressOptions, SettingsOptions
from heliograph.media import open_film
from heliograph.media.images import is_pattern
from heliograph.media.live.reader import is_camera
from heliograph.media.live.settings import camera_settings


def run_serve(
    films: list[Path],
    options: AddressOptions,
    camera: list[str] | None,
    settings_options: SettingsOptions,
    *,
    browse: bool,
) -> None:
    """Serve the pages until Ctrl-C."""
    if (options.certificate is None) != (options.key is None):
        raise SettingsError("HTTPS requires both --certificate and --key")
    for film in films:
        if not (is_camera(film) or is_pattern(film) or film.exists()):
            raise MediaError(f"there is no file {film}: check the name")
        if not is_camera(film):
            # report unreadable films now; pages can set another frame rate
            open_film(film, rate_hz=1.0).close()
    settings = settings_options.load()
    camera_settings(camera or ())
    try:
        from heliograph.web.app import create_app
        from heliograph.web.limits import Limits
        from heliograph.web.serve import Address, open_port, run
    except ImportError as error:
        raise MediaError(f"the pages require the extra 'web' ({error.name}): pip install 'heliograph[web]'") from None
    address, limits = Address(options.host, options.port, options.certificate, options.key), Limits()
    access = address.access()
    with open_port(address) as listener:
        url = address.url(listener.getsockname()[1], access.token)
        app = create_app(settings, [str(film) for film in films], access, limits, camera or ())
        show_address(url, is_loopback=address.is_loopback, is_secure=address.is_secure)
        if browse:
            webbrowser.open(url)
        with contextlib.suppress(KeyboardInterrupt):
            run(app, listener, address, limits)
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
