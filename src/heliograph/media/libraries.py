"""Libraries for films, which load on first use."""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any


class LazyModule(ModuleType):
    """Module that loads with the first use of an attribute, as some take longer than many commands take to run."""

    def __getattr__(self, name: str) -> Any:
        module = import_module(self.__name__)
        self.__dict__.update(vars(module))
        return getattr(module, name)


if TYPE_CHECKING:
    import av
    import cv2
    import h5py
    import tifffile
    from PIL import Image
else:
    av, cv2, h5py, tifffile, Image = map(LazyModule, ("av", "cv2", "h5py", "tifffile", "PIL.Image"))

__all__ = ["Image", "av", "cv2", "h5py", "tifffile"]
