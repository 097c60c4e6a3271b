"""Web application: routes of the pages, errors as JSON, and access control."""

import contextlib
from collections.abc import AsyncIterator, Sequence

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from heliograph.base.errors import HeliographError
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.web import built, files, receive, transmit, watch
from heliograph.web.crashes import CrashReports, is_crash
from heliograph.web.limits import Limits
from heliograph.web.security import Access, Guard
from heliograph.web.shared import BusyError, Shared
from heliograph.web.uploads import TooLargeError


def create_app(
    settings: LinkSettings | None = None,
    films: Sequence[str] = (),
    access: Access | None = None,
    limits: Limits | None = None,
    camera: Sequence[str] = (),
) -> FastAPI:
    """Create the application of `heliograph serve`."""
    limits = limits or Limits()
    shared = Shared(settings or load_settings("paper"), tuple(films), limits, tuple(camera))

    @contextlib.asynccontextmanager
    async def lifespan(_app: FastAPI) -> AsyncIterator[None]:
        with contextlib.closing(shared.uploads):
            yield

    app = FastAPI(title="Heliograph", openapi_url=None, docs_url=None, redoc_url=None, lifespan=lifespan)
    app.state.shared = shared
    for module in (files, watch, transmit, receive, built):
        app.include_router(module.router)
    app.add_exception_handler(HeliographError, _answer_user_error)
    app.add_exception_handler(HTTPException, _answer_http_error)
    app.add_exception_handler(RequestValidationError, _answer_invalid_request)
    app.add_middleware(CrashReports)
    app.add_middleware(Guard, access=access or Access(), limits=limits)
    return app


async def _answer_user_error(_request: Request, error: Exception) -> JSONResponse:
    if is_crash(error):
        raise error
    status = 413 if isinstance(error, TooLargeError) else 503 if isinstance(error, BusyError) else 400
    # the rest of a large request stays unread
    return JSONResponse({"error": str(error)}, status, {"connection": "close"} if status == 413 else None)


async def _answer_http_error(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": str(error.detail)}, error.status_code, error.headers)


async def _answer_invalid_request(_request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    first = error.errors()[0] if error.errors() else {"loc": (), "msg": "invalid request"}
    return JSONResponse({"error": f"{'.'.join(map(str, first['loc']))}: {first['msg']}"[:400]}, 422)
