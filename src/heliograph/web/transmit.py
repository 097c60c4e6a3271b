"""The server's part of page *Transmit*: a text or file comes in, packets of patterns go out."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask
from starlette.requests import ClientDisconnect

from heliograph.base.errors import MediaError
from heliograph.media import create_film
from heliograph.web.crashes import in_thread
from heliograph.web.sending import (
    LEAST_RATE_HZ,
    LED_PX,
    MARGIN,
    MOST_PACKETS,
    MOST_RATE_HZ,
    MOST_SENT,
    Sending,
    Sendings,
    sending_of,
)
from heliograph.web.shared import Places, shared_of

MOST_FILM_PATTERNS = 36_000
"""Most patterns of a film: ten minutes at 60 a second, half a minute's work."""

router = APIRouter(prefix="/api/transmit")

# films that are written at once; whoever asks for more is told to come again
_films = Places(2, "films of patterns")


def sendings_of(request: Request) -> Sendings:
    """What this server's pages send."""
    state = request.app.state
    if not hasattr(state, "sendings"):
        state.sendings = Sendings()
    sendings: Sendings = state.sendings
    return sendings


Known = Annotated[Sendings, Depends(sendings_of)]
Rate = Annotated[float, Query(ge=LEAST_RATE_HZ, le=MOST_RATE_HZ, allow_inf_nan=False)]


@router.post("", status_code=201)
async def begin(
    request: Request,
    known: Known,
    rate_hz: Rate = 10.0,
    side: Annotated[int, Query(ge=8, le=32, multiple_of=4)] = 16,
    name: Annotated[str | None, Query(max_length=400)] = None,
) -> dict[str, Any]:
    """Take a text or a file as the body of a request; say how it will be sent, and by what name its packets are had."""
    data = bytearray()
    try:
        async for part in request.stream():
            data += part
            if len(data) > MOST_SENT:
                raise MediaError(f"a screen sends at most {MOST_SENT >> 10} kB: choose a smaller file")
    except ClientDisconnect:
        raise MediaError("the text or file broke off: send it again") from None
    sending = await in_thread(lambda: sending_of(bytes(data), name, side, rate_hz))
    return {"sending": known.add(sending), **sending.facts()}


@router.get("/{name}/packets")
async def packets(
    name: str,
    known: Known,
    first: Annotated[int, Query(ge=0, le=10**9)] = 0,
    count: Annotated[int, Query(ge=1, le=MOST_PACKETS)] = 1,
) -> Response:
    """Give packets: the levels 0 to 4 of all cells, a byte each, row by row, pattern by pattern."""
    sending = known.of(name)
    levels = await in_thread(lambda: sending.packets(first, count).tobytes())
    return Response(levels, media_type="application/octet-stream")


# longest film of patterns in s: larger files come in parts, as any packets will do
@router.get("/{name}/film")
async def film(
    request: Request,
    name: str,
    known: Known,
    seconds: Annotated[float, Query(gt=0, le=600.0, allow_inf_nan=False)] = 30.0,
    gamma: Annotated[float, Query(ge=1, le=4, allow_inf_nan=False)] = 2.2,
) -> FileResponse:
    """Give the patterns as a video, for any screen that plays one."""
    sending = known.of(name)
    if seconds * sending.rate_hz > MOST_FILM_PATTERNS:
        raise MediaError(f"such a film has at most {MOST_FILM_PATTERNS} patterns: ask for fewer seconds")
    path = shared_of(request).uploads.folder() / f"patterns-{token_hex(8)}.mp4"
    with _films.take(), _gone_if_it_fails(path):
        await in_thread(lambda: _write(path, sending, seconds, gamma))
    return FileResponse(path, filename="patterns.mp4", background=BackgroundTask(path.unlink, missing_ok=True))


@contextmanager
def _gone_if_it_fails(path: Path) -> Iterator[None]:
    try:
        yield
    except BaseException:
        path.unlink(missing_ok=True)
        raise


def _write(path: Path, sending: Sending, seconds: float, gamma: float) -> None:
    edge = (sending.side + 2 * MARGIN) * LED_PX
    with create_film(path, width=edge, height=edge, rate_hz=sending.rate_hz) as out:
        for frame in sending.frames(seconds, gamma):
            out.write(frame)
