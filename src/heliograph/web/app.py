"""Web application: routes of the pages, errors as JSON, and access control."""

import contextlib
import tempfile
from collections.abc import AsyncIterator, Sequence
from pathlib import Path

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.types import Lifespan

from heliograph.base.errors import HeliographError
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.web import built, files, receive, transmit, watch
from heliograph.web.crashes import is_crash, report
from heliograph.web.recorded_drive import RECORDED_DRIVE
from heliograph.web.security import HEADERS, Access, Guard
from heliograph.web.shared import Limits, Shared
from heliograph.web.stores import BusyError, MissingError
from heliograph.web.wording import page_words

STATUS: dict[type[Exception], int] = {files.TooLargeError: 413, BusyError: 503, MissingError: 404}
"""Status of responses by expected error; 400 for other errors."""


def create_app(
    settings: LinkSettings | None = None,
    films: Sequence[str] = (),
    access: Access | None = None,
    limits: Limits | None = None,
    camera: Sequence[str] = (),
    *,
    is_auto: bool = False,
    phone_url: str = "",
) -> FastAPI:
    """Create the application of `heliograph serve`; with `is_auto` each film decides the receiver.

    `phone_url` is the address of page *Receive* for other machines; empty if only this machine has access.
    Without films, page *Watch* offers a recorded drive.
    """
    limits = limits or Limits()
    shown = tuple(films) or (str(RECORDED_DRIVE),)
    link = settings or load_settings("paper")
    shared = Shared(link, shown, limits, tuple(camera), is_auto=is_auto, phone_url=phone_url)

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        with tempfile.TemporaryDirectory(prefix="heliograph-", ignore_cleanup_errors=True) as folder:
            shared.folder = Path(folder)
            try:
                yield
            finally:
                if app.state.network is not None:
                    await app.state.network.close()

    return guarded_app(shared, access or Access(), lifespan)


def guarded_app(shared: Shared, access: Access, lifespan: Lifespan[FastAPI] | None = None) -> FastAPI:
    """Create the application of a listener; `state.network` is the network listener that this application controls."""
    app = FastAPI(title="Heliograph", openapi_url=None, docs_url=None, redoc_url=None, lifespan=lifespan)
    app.state.shared, app.state.network = shared, None
    for module in (files, watch, transmit, receive, built):
        app.include_router(module.router)
    for kind in (HeliographError, HTTPException, RequestValidationError, ClientDisconnect, Exception):
        app.add_exception_handler(kind, _answer_error)
    app.add_middleware(Guard, access=access)
    return app


async def _answer_error(_request: Request, error: Exception) -> JSONResponse:
    """Answer a request with the error as a line of text."""
    match error:
        case HTTPException():
            return JSONResponse({"error": str(error.detail)}, error.status_code, error.headers)
        case RequestValidationError():
            first = error.errors()[0] if error.errors() else {"loc": (), "msg": "invalid request"}
            return JSONResponse({"error": f"{'.'.join(map(str, first['loc']))}: {first['msg']}"[:400]}, 422)
        case ClientDisconnect():
            return JSONResponse({"error": "the upload was interrupted: send it again"}, 400)
        case HeliographError() if not is_crash(error):
            status = STATUS.get(type(error), 400)
            # the rest of a large request stays unread
            headers = {"connection": "close"} if status == 413 else None
            return JSONResponse({"error": page_words(str(error))}, status, headers)
    # handlers of unexpected errors run outside the middleware
    return JSONResponse({"error": report(error)}, 500, HEADERS)
