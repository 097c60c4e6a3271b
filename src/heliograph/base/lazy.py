"""Libraries that load on first use, as they take longer to load than many commands take to run."""

from importlib import import_module
from types import ModuleType
from typing import Any


class LazyModule(ModuleType):
    """Module that loads with the first use of an attribute; a type checker needs a plain import."""

    def __getattr__(self, name: str) -> Any:
        module = import_module(self.__name__)
        self.__dict__.update(vars(module))
        return getattr(module, name)
