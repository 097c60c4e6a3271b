"""Libraries for films, which load on first use."""

from typing import TYPE_CHECKING

from heliograph.base.lazy import LazyModule

if TYPE_CHECKING:
    import av
    import cv2
    import h5py
    import tifffile
    from PIL import Image
else:
    av, cv2, h5py, tifffile, Image = map(LazyModule, ("av", "cv2", "h5py", "tifffile", "PIL.Image"))

__all__ = ["Image", "av", "cv2", "h5py", "tifffile"]
