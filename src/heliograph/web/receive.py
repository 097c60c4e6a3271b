"""The server's part of page *Receive*."""

from fastapi import APIRouter

router = APIRouter(prefix="/api/receive")
