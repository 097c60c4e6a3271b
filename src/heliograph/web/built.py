"""The built pages, which the package carries; their sources are in the folder web/ of the repository."""

import mimetypes
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable

from fastapi import APIRouter, Response
from starlette.exceptions import HTTPException

PAGES = ("index", "watch", "transmit", "receive")

TYPES = {".js": "text/javascript", ".css": "text/css", ".svg": "image/svg+xml", ".html": "text/html"}
"""Kinds of files by their suffix; what the machine says of them may be anything."""


@cache
def built() -> dict[str, bytes]:
    """All built files by their name: nothing that a browser asks for becomes a path of the disk."""
    return dict(_within(files("heliograph.web") / "pages", ""))


def _within(folder: Traversable, before: str) -> list[tuple[str, bytes]]:
    out = []
    for one in folder.iterdir():
        out += _within(one, f"{before}{one.name}/") if one.is_dir() else [(before + one.name, one.read_bytes())]
    return out


router = APIRouter()


@router.get("/{name:path}")
async def page(name: str) -> Response:
    """Give a page or a file of one."""
    name = f"{name or 'index'}.html" if (name or "index") in PAGES else name
    data = built().get(name)
    if data is None:
        raise HTTPException(404, "there is no such page")
    suffix = name[name.rfind(".") :]
    kind = TYPES.get(suffix) or mimetypes.guess_type(name)[0] or "application/octet-stream"
    return Response(data, media_type=kind)
