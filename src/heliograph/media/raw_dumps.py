"""Recognise raw dumps: files of levels without any header, whose frames have no known size."""

import mmap
from pathlib import Path

from heliograph.base.errors import MediaError

_GRAY = (
    ".raw", ".raw8", ".raw10", ".raw12", ".raw16", ".bin", ".dat", ".data", ".dump", ".gray", ".gray8", ".gray16",
    ".grey", ".y", ".y8", ".y10", ".y12", ".y16", ".mono8", ".mono16", ".bayer", ".rgb", ".bgr", ".img",
)  # fmt: skip
"""Suffixes of dumps of whole frames."""

_YUV = (".yuv", ".i420", ".yv12", ".nv12", ".nv21", ".yuv420p")
"""Suffixes of dumps in which half a frame of colours follows the gray levels of each frame."""


def check_header(path: Path) -> None:
    """Refuse a file whose suffix is that of raw dumps, unless FFmpeg knows its content."""
    suffix = path.suffix.lower()
    if suffix not in (*_GRAY, *_YUV) or _is_video(path):
        return
    shape = "-1, ROWS, COLUMNS))" if suffix in _GRAY else "-1, ROWS * 3 // 2, COLUMNS)[:, :ROWS])"
    raise MediaError(
        f"{path} ({path.stat().st_size} bytes) has no known header. A raw dump does not tell the size of its frames: "
        f"save it as .npy by python -c \"import numpy as n; n.save('{path.stem}.npy', "
        f"n.fromfile('{path.name}', 'u1').reshape({shape}\", with '<u2' in place of 'u1' for words of 16 bits"
    )


def _is_video(path: Path) -> bool:
    """True if FFmpeg finds pictures in the content, whatever the suffix: it takes any .bin file for text art."""
    import av

    try:
        # a file object would tell FFmpeg its name
        with (
            path.open("rb") as file,
            mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
            av.open(content) as container,
        ):
            return any(stream.width and stream.height for stream in container.streams.video)
    except (av.error.FFmpegError, OSError, ValueError):
        return False
