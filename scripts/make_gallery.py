"""Make the pictures of docs/gallery.md from the demo, the reproduction and the notebooks.

    python scripts/make_gallery.py demo reproduction

The arguments are the output folders of `heliograph demo` and `heliograph reproduce`. Pictures of a missing
folder remain.
"""

import base64
import io
import json
import re
import sys
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).parents[1] / "docs"
MAX_WIDTH, MAX_BYTES = 1000, 150_000

DEMO = ("", "demo-far", "demo-near", "demo-junction", "demo-picture", "demo-tracking", "demo-untracked", "demo-tracked",
        "demo-errors", "demo-errors-soft")  # fmt: skip
"""Names of the pictures of the demo's report, in order; the first is the animation."""

NOTEBOOKS = {
    "patterns": ("quick_start", 0),
    "notebook-quick-start": ("quick_start", 1),
    "notebook-error-rates": ("error_rates", 0),
    "notebook-own-receiver": ("own_receiver", 0),
    "notebook-own-recording": ("own_recording", 0),
}
"""Notebook and number of each picture."""


def save(picture: bytes, name: str) -> None:
    """Write a plot as it is, another picture as a small WebP, lossless if it is small enough."""
    path = DOCS / "pictures" / name
    if picture.startswith(b"<?xml"):
        path.with_suffix(".svg").write_bytes(picture)
        path.with_suffix(".webp").unlink(missing_ok=True)
        return
    image = Image.open(io.BytesIO(picture)).convert("RGB")
    if image.width > MAX_WIDTH:
        image = image.resize((MAX_WIDTH, round(image.height * MAX_WIDTH / image.width)), Image.Resampling.LANCZOS)
    for options in ({"lossless": True}, {"quality": 85}, {"quality": 60}):
        out = io.BytesIO()
        image.save(out, "webp", method=6, **options)
        if len(out.getvalue()) <= MAX_BYTES / 3:
            break
    if len(out.getvalue()) > MAX_BYTES:
        raise ValueError(f"{name} has {len(out.getvalue())} bytes, more than {MAX_BYTES}")
    path.with_suffix(".webp").write_bytes(out.getvalue())


def notebook_picture(name: str, number: int) -> bytes:
    """Return a stored picture of a notebook."""
    cells = json.loads((DOCS / "notebooks" / f"{name}.ipynb").read_text())["cells"]
    data = [output.get("data", {}) for cell in cells for output in cell.get("outputs", [])]
    pictures = [found["image/png"] for found in data if "image/png" in found]
    return base64.b64decode(pictures[number])


def main(demo: Path, reproduction: Path) -> None:
    if (report := demo / "report.html").is_file():
        found = re.findall(r'src="data:image/[\w+]+;base64,([^"]+)"', report.read_text())
        if len(found) != len(DEMO):
            raise ValueError(f"{report} has {len(found)} pictures, not {len(DEMO)}: adapt the list DEMO")
        for name, text in zip(DEMO, found, strict=True):
            if name:
                save(base64.b64decode(text), name)
    for path in sorted(reproduction.glob("*-[0-9].svg")):
        save(path.read_bytes(), path.stem.replace("soft-", "reproduce-soft-"))
    for name, place in NOTEBOOKS.items():
        save(notebook_picture(*place), name)


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:3]))
