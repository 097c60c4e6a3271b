"""GenICam cameras through a maker's producer (.cti), by harvesters."""

import glob
import logging
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, brief
from heliograph.media.live.camera import CameraForm, CameraKind, CameraLostError, Found, Picture
from heliograph.media.live.features import FeatureCamera
from heliograph.media.live.settings import CameraSettings, Value

FOLDERS = "GENICAM_GENTL64_PATH"  # environment variable with the folders of producers (GenTL 1.6, section 3.3)


class GenicamCamera(FeatureCamera):
    """A camera behind a GenICam producer; see `Camera`. harvesters calls `emit` for each incomplete picture."""

    def __init__(self, address: str):
        super().__init__(address)
        self._harvester: Any = None
        self._acquirer: Any = None
        self._broken = 0
        self._ticks_hz: float | None = None

    def open(self, settings: CameraSettings) -> CameraForm:
        """Connect and configure the camera; see `Camera`."""
        self._harvester = _harvester(settings)
        cameras = self._harvester.device_info_list
        info = next((info for info in cameras if self._address in ("", info.id_, _text(info, "serial_number"))), None)
        if info is None:
            raise MediaError(f"no producer has a camera '{self._address}'; see 'heliograph cameras'")
        try:
            self._acquirer = self._harvester.create(cameras.index(info))
        except Exception as error:  # harvesters and genicam raise many types
            raise MediaError(f"camera '{info.id_}' cannot be opened ({brief(error)}): is it in use?") from None
        self._acquirer.add_callback(self._acquirer.Events.INCOMPLETE_BUFFER, self)
        form = self._configure(settings, f"{_text(info, 'vendor')} {_text(info, 'model')}")
        self._acquirer.num_buffers = self.n_buffers
        return form

    def frames(self, wait_s: float) -> Sequence[Picture]:
        """Return the pictures since the last call; see `Camera`."""
        try:
            if not self._acquirer.is_acquiring():
                self._acquirer.start()
            buffer = self._acquirer.try_fetch(timeout=max(wait_s, 1e-3), is_raw=True)
            broken, self._broken = self._broken, 0
            pictures = [Picture(None)] * broken
            if buffer is not None:
                pictures.append(self._convert(buffer))
                buffer.parent.queue_buffer(buffer)
        except MediaError:
            raise
        except Exception as error:  # harvesters and genicam raise many types
            raise CameraLostError(f"{type(error).__name__}: {brief(error)}") from None
        return pictures

    def close(self) -> None:
        """Stop and release the camera; see `Camera`."""
        acquirer, harvester, self._acquirer, self._harvester = self._acquirer, self._harvester, None, None
        for end in (acquirer and acquirer.stop, acquirer and acquirer.destroy, harvester and harvester.reset):
            try:
                if end:
                    end()
            except Exception as error:  # a lost camera cannot be stopped
                logging.getLogger(__name__).debug("closing: %s", error)

    def emit(self, context: object = None) -> None:  # noqa: ARG002 - harvesters' signature
        """Count an incomplete picture."""
        self._broken += 1

    def _node(self, name: str) -> Any:
        if not self._has(name):
            raise MediaError(f"it has no feature {name}")
        return _get(self._acquirer.remote_device.node_map, name)

    def _has(self, name: str) -> bool:
        nodes = self._acquirer.remote_device.node_map
        return bool(nodes.has_node(name)) and _get(nodes, name) is not None

    def _read(self, name: str) -> Value:
        try:
            value = self._node(name).value
        except MediaError:
            raise
        except Exception as error:
            raise MediaError(f"{name} cannot be read: {brief(error)}") from None
        return str(value).lower() if isinstance(value, bool) else value

    def _write(self, name: str, value: Value) -> None:
        node = self._node(name)
        try:
            if isinstance(value, str):
                node.from_string(value)
            else:
                node.value = type(node.value)(value)
        except Exception as error:
            raise MediaError(f"{brief(error)}{_bounds(node)}") from None

    def _values(self, name: str) -> list[str]:
        return list(self._node(name).symbolics)

    def _convert(self, buffer: Any) -> Picture:
        data = np.frombuffer(buffer.raw_buffer, np.uint8)[int(_get(buffer, "image_offset") or 0) :]
        number, stamp_ns = _get(buffer, "frame_id"), self._stamp(buffer)
        picture = self._picture(data, int(_get(buffer, "padding_x") or 0), number, stamp_ns)
        # the producer reuses the buffer
        return picture if picture.pixels is None else Picture(picture.pixels.copy(), picture.number, picture.stamp_ns)

    def _stamp(self, buffer: Any) -> int | None:
        """Return the start of a picture's exposure by the camera's clock in ns."""
        if (stamp := _get(buffer, "timestamp_ns")) is not None:
            return int(stamp)
        if not (ticks := _get(buffer, "timestamp")):
            return None
        if self._ticks_hz is None:
            self._ticks_hz = float(_get(buffer.parent.parent, "timestamp_frequency") or 1e9)
        return round(int(ticks) * 1e9 / self._ticks_hz)


def _get(source: Any, name: str) -> Any:
    """Return an attribute; None if missing."""
    try:
        return getattr(source, name)
    except Exception:  # genicam raises many types
        return None


def _text(info: Any, name: str) -> str:
    return str(_get(info, name) or "")


def _bounds(node: Any) -> str:
    """Return the range of a number, for an error."""
    low, high, step = (_get(node, name) for name in ("min", "max", "inc"))
    if low is None or high is None:
        return ""
    return f" ({low:g} to {high:g}" + (f" in steps of {step:g})" if step else ")")


def producers(settings: CameraSettings) -> list[str]:
    """Return the files of GenICam producers: the file in the settings, or the files in the folders of `FOLDERS`."""
    if settings.producer is not None:
        if not Path(settings.producer).is_file():
            raise MediaError(f"there is no producer {settings.producer}: check the name of the .cti file")
        return [settings.producer]
    folders = [folder for folder in os.environ.get(FOLDERS, "").split(os.pathsep) if folder]
    files = sorted(file for folder in folders for file in glob.glob(os.path.join(glob.escape(folder), "*.cti")))
    if not files:
        place = f"{', '.join(folders)} has none" if folders else f"{FOLDERS} is not set"
        cure = "install the maker's driver, or give the file by --camera producer=FILE"
        raise MediaError(f"GenICam cameras need a maker's producer (.cti), and {place}: {cure}")
    return files


def _harvester(settings: CameraSettings) -> Any:
    """Return a harvester with the cameras of all producers."""
    try:
        from harvesters.core import Harvester
    except ModuleNotFoundError as error:
        raise MediaError(f"GenICam cameras need 'pip install harvesters' ({brief(error)})") from None
    except ImportError as error:  # such as libpython, which the binding of some Python versions needs
        raise MediaError(f"harvesters cannot be loaded: {brief(error)}; install the named library") from None
    files = producers(settings)
    logging.getLogger("harvesters").setLevel(logging.CRITICAL)  # the errors below are enough
    harvester = Harvester()
    for file in files:
        try:
            harvester.add_file(file, check_validity=True)
        except OSError as error:
            raise MediaError(f"the producer {file} cannot be loaded: {brief(error)}") from None
    harvester.update()
    return harvester


def find(settings: CameraSettings) -> list[Found]:
    """List the cameras of all producers."""
    harvester = _harvester(settings)
    try:
        return [
            Found(info.id_, f"{_text(info, 'vendor')} {_text(info, 'model')}, {_text(info, 'tl_type')}")
            for info in harvester.device_info_list
        ]
    finally:
        harvester.reset()


KIND = CameraKind(GenicamCamera, find)  # cameras behind GenICam producers
