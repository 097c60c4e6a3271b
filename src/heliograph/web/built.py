"""Static pages in the package, built from the sources in the folder web/ of the repository."""

import mimetypes
from functools import cache
from pathlib import Path

from fastapi import APIRouter, Response
from starlette.exceptions import HTTPException

from heliograph.web.replay import recorded_page
from heliograph.web.security import inline_policy

PAGES = ("index", "watch", "transmit", "receive", "glossary")


@cache
def built() -> dict[str, bytes]:
    """Return all files by name; requests for other names never reach the disk."""
    folder = Path(__file__).parent / "pages"
    return {file.relative_to(folder).as_posix(): file.read_bytes() for file in folder.rglob("*") if file.is_file()}


# independent of the configuration of the machine
_types = mimetypes.MimeTypes()
_types.add_type("text/javascript", ".js")

router = APIRouter()


@router.get("/replay")
def replay() -> Response:
    """Return the replay of the recorded drive."""
    page = recorded_page()
    return Response(page, media_type="text/html", headers={"content-security-policy": inline_policy(page)})


@router.get("/{name:path}")
async def page(name: str) -> Response:
    """Return a page or a file of a page."""
    name = f"{name or 'index'}.html" if (name or "index") in PAGES else name
    if name not in built():
        raise HTTPException(404, "page not found")
    return Response(built()[name], media_type=_types.guess_type(name)[0] or "application/octet-stream")
