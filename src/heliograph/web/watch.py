"""The server's part of page *Watch*."""

from fastapi import APIRouter

router = APIRouter(prefix="/api/watch")
