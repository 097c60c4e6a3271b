"""heliograph serve."""

import contextlib
import sys
import webbrowser
from pathlib import Path

from heliograph.base.errors import MediaError, SettingsError
from heliograph.cli import console, options


def run_serve(
    films: list[Path],
    place: tuple[str, int],
    certificate: Path | None,
    key: Path | None,
    browse: bool,
    camera: list[str] | None,
    preset: str,
    file: Path | None,
    changes: list[str],
) -> None:
    """Serve the pages until Ctrl-C; other machines come in by a token, which is printed with a QR code."""
    from heliograph.media import open_film
    from heliograph.media.images import is_pattern
    from heliograph.media.live.reader import is_camera
    from heliograph.media.live.settings import camera_settings

    if (certificate is None) != (key is None):
        raise SettingsError("HTTPS requires both --certificate and --key")
    for film in films:
        if not (is_camera(film) or is_pattern(film) or film.exists()):
            raise MediaError(f"there is no file {film}: check the name")
        if not is_camera(film):
            # whether it is a film shows at once, not in the browser; its rate may be said there
            open_film(film, rate_hz=1.0).close()
    settings = options.settings_from(preset, file, changes)
    camera_settings(camera or ())
    try:
        from heliograph.web.app import create_app
        from heliograph.web.limits import Limits
        from heliograph.web.serve import Address, open_port, run
    except ImportError as error:
        raise MediaError(f"the pages take the extra 'web' ({error.name}): pip install 'heliograph[web]'") from None
    address, limits = Address(*place, certificate, key), Limits()
    access = address.access()
    with open_port(address) as waiting:
        url = address.url(waiting.getsockname()[1], access.token)
        app = create_app(settings, [str(film) for film in films], access, limits, camera or ())
        show_address(url, is_loopback=address.is_loopback, is_secure=address.is_secure)
        if browse:
            webbrowser.open(url)
        with contextlib.suppress(KeyboardInterrupt):  # the end that it was told to wait for
            run(app, waiting, address, limits)
    console.say("ended")


def show_address(url: str, is_loopback: bool, is_secure: bool) -> None:
    """Say what to open: on this machine alone, or on others, which get a QR code to film."""
    console.say(f"Heliograph is at {url}  (Ctrl-C ends it)")
    if is_loopback:
        return
    if sys.stdout.isatty():
        import segno

        segno.make(url, error="l").terminal(compact=True)
    console.complain("whoever has this address may use this server: keep it to yourself")
    if not is_secure:
        console.complain(
            "without --certificate and --key browsers keep their own camera from these pages; films are taken"
        )
