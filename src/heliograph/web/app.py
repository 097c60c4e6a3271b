"""The application: its pages, what they ask for, and the guard before them."""

import contextlib
from collections.abc import AsyncIterator, Sequence

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from heliograph.base.errors import HeliographError
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.web import built, receive, transmit, uploads, watch
from heliograph.web import failures as bundles
from heliograph.web.crashes import CrashReports, is_crash
from heliograph.web.limits import Limits
from heliograph.web.security import Door, Guard
from heliograph.web.shared import BusyError, Shared
from heliograph.web.uploads import TooLargeError, Uploads


def create_app(
    settings: LinkSettings | None = None,
    films: Sequence[str] = (),
    door: Door | None = None,
    limits: Limits | None = None,
    camera: Sequence[str] = (),
) -> FastAPI:
    """Make the application that `heliograph serve` runs."""
    limits = limits or Limits()
    shared = Shared(settings or load_settings("paper"), tuple(films), limits, Uploads(limits), tuple(camera))

    @contextlib.asynccontextmanager
    async def alive(_app: FastAPI) -> AsyncIterator[None]:
        try:
            yield
        finally:
            shared.uploads.close()

    app = FastAPI(title="Heliograph", openapi_url=None, docs_url=None, redoc_url=None, lifespan=alive)
    app.state.shared = shared
    for room in (uploads, bundles, watch, transmit, receive, built):
        app.include_router(room.router)
    app.add_exception_handler(HeliographError, _refused)
    app.add_exception_handler(HTTPException, _failed)
    app.add_exception_handler(RequestValidationError, _not_understood)
    app.add_middleware(CrashReports)
    app.add_middleware(Guard, door=door or Door(), limits=limits)
    return app


async def _refused(_request: Request, error: Exception) -> JSONResponse:
    """What a user can mend, as the command would say it."""
    if is_crash(error):
        raise error
    status = 413 if isinstance(error, TooLargeError) else 503 if isinstance(error, BusyError) else 400
    # what is left of a request is not read
    return JSONResponse({"error": str(error)}, status, {"connection": "close"} if status == 413 else None)


async def _failed(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": str(error.detail)}, error.status_code, error.headers)


async def _not_understood(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0] if error.errors() else {"loc": (), "msg": "not understood"}
    place = ".".join(map(str, first["loc"]))
    return JSONResponse({"error": f"{place}: {first['msg']}"[:400]}, 422)
