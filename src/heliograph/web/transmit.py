"""The server's part of page *Transmit*."""

from fastapi import APIRouter

router = APIRouter(prefix="/api/transmit")
