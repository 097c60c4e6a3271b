"""Routes of page *Transmit*: packets of patterns for a text or file."""

import contextlib
import io
from pathlib import Path
from secrets import token_hex
from typing import Annotated, Any

import segno
from fastapi import APIRouter, Query, Request, Response
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask
from starlette.exceptions import HTTPException

from heliograph.base.errors import MediaError
from heliograph.media import create_film
from heliograph.probe.screens import SIDES
from heliograph.web.crashes import in_thread
from heliograph.web.sending import MARGIN, MAX_RATE_HZ, MIN_RATE_HZ, Sending, check_size, sending_of
from heliograph.web.shared import SharedState, body_of

router = APIRouter(prefix="/api/transmit")


@router.post("", status_code=201)
async def begin(
    request: Request,
    shared: SharedState,
    rate_hz: Annotated[float, Query(ge=MIN_RATE_HZ, le=MAX_RATE_HZ, allow_inf_nan=False)] = 10.0,
    side: Annotated[int, Query(ge=SIDES[0], le=SIDES[-1], multiple_of=4)] = 16,
    name: Annotated[str | None, Query(max_length=400)] = None,
    inverses: bool = True,
    is_preview: bool = False,
) -> dict[str, Any]:
    """Store a text or file, the body of a request; return the key and properties of the transmission.

    A preview returns a pattern in place of the key, and stores nothing.
    """
    data = bytearray()
    async for part in body_of(request, shared.limits.idle_s):
        data += part
        check_size(len(data))
    sending = await in_thread(lambda: sending_of(bytes(data), name, side, rate_hz, inverses))
    if is_preview:
        patterns = await in_thread(lambda: sending.packets(0, 1))
        return {"pattern": patterns[len(patterns) // 2].ravel().tolist(), **sending.facts()}
    return {"sending": shared.sendings.add(sending), **sending.facts()}


@router.get("/phone")
async def phone(request: Request, shared: SharedState) -> dict[str, Any]:
    """Return the address of page *Receive* for a phone, and the QR code in SVG; empty if no phone has access.

    `opens` is true if this page may open and close the network.
    """
    code = io.BytesIO()
    if shared.phone_url:
        segno.make(shared.phone_url, error="l").save(code, kind="svg", scale=8, light="#fff")
    opens = request.app.state.network is not None
    return {"url": shared.phone_url, "code": code.getvalue().decode(), "opens": opens}


@router.put("/phone")
async def open_network(request: Request, shared: SharedState) -> dict[str, Any]:
    """Listen to the network with a new token."""
    await _network_of(request).open()
    return await phone(request, shared)


@router.delete("/phone")
async def close_network(request: Request, shared: SharedState) -> dict[str, Any]:
    """Disconnect other machines, and listen to this machine only."""
    await _network_of(request).close()
    return await phone(request, shared)


def _network_of(request: Request) -> Any:
    if request.app.state.network is None:
        raise HTTPException(403, "only the pages on the machine of the server open and close the network")
    return request.app.state.network


@router.get("/{name}/packets")
async def packets(
    name: str,
    shared: SharedState,
    first: Annotated[int, Query(ge=0, le=10**9)] = 0,
    # 16 packets of 128 x 128 cells have 8 MB
    count: Annotated[int, Query(ge=1, le=16)] = 1,
) -> Response:
    """Return packets: PWM levels 0 to 4 of all cells, a byte each, row by row, pattern by pattern."""
    sending = shared.sendings.of(name)
    levels = await in_thread(lambda: sending.packets(first, count).tobytes())
    return Response(levels, media_type="application/octet-stream")


@router.get("/{name}/film")
async def film(
    name: str,
    shared: SharedState,
    # any packets of a file will do: long transmissions may be split
    seconds: Annotated[float, Query(gt=0, le=600.0, allow_inf_nan=False)] = 30.0,
    gamma: Annotated[float, Query(ge=1, le=4, allow_inf_nan=False)] = 2.2,
) -> FileResponse:
    """Return the patterns as a video for any display."""
    sending = shared.sendings.of(name)
    # ten minutes at 60 patterns/s, half a minute of computing
    if seconds * sending.rate_hz > 36_000:
        raise MediaError("such a film has at most 36000 patterns: choose fewer seconds")
    path = shared.folder / f"patterns-{token_hex(8)}.mp4"
    with contextlib.ExitStack() as cleanup, shared.pattern_films.take():
        cleanup.callback(path.unlink, missing_ok=True)
        await in_thread(lambda: _write(path, sending, seconds, gamma))
        cleanup.pop_all()
    return FileResponse(path, filename="patterns.mp4", background=BackgroundTask(path.unlink, missing_ok=True))


def _write(path: Path, sending: Sending, seconds: float, gamma: float) -> None:
    edge = (sending.side + 2 * MARGIN) * sending.cell_px
    with create_film(path, width=edge, height=edge, rate_hz=sending.rate_hz) as out:
        for frame in sending.frames(seconds, gamma):
            out.write(frame)
