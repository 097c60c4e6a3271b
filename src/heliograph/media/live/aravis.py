"""GigE Vision and USB3 Vision cameras by Aravis, called through ctypes."""

import contextlib
import ctypes
from collections.abc import Callable, Sequence
from ctypes import POINTER, byref, c_char_p, c_int, c_size_t, c_uint, c_uint64, c_void_p
from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.media.live.camera import CameraForm, CameraKind, CameraLostError, Found, Picture
from heliograph.media.live.features import FeatureCamera
from heliograph.media.live.settings import CameraSettings, Value

_Signatures = dict[tuple[Any, tuple[Any, ...]], str]  # names of functions by result and arguments

_PLAIN: _Signatures = {
    (None, ()): "arv_update_device_list",
    (c_uint, ()): "arv_get_n_devices",
    (c_char_p, (c_uint,)): "arv_get_device_id arv_get_device_serial_nbr arv_get_device_vendor arv_get_device_model "
    "arv_get_device_protocol arv_get_device_address",
    (c_void_p, (c_void_p,)): "arv_camera_get_device",
    (c_int, (c_void_p,)): "arv_camera_is_gv_device arv_gv_device_is_controller",
    (None, (c_void_p, c_int)): "arv_camera_set_range_check_policy",
    (c_void_p, (c_void_p, c_char_p)): "arv_device_get_feature",
    (c_void_p, (c_size_t, c_void_p)): "arv_buffer_new",
    (None, (c_void_p, c_void_p)): "arv_stream_push_buffer",
    (c_void_p, (c_void_p, c_uint64)): "arv_stream_timeout_pop_buffer",
    # names and values of any number, up to a null
    (None, (c_void_p, c_char_p, c_int, c_char_p, c_int, c_void_p)): "g_object_set",
    (None, (c_void_p,)): "g_object_unref g_free g_error_free",
}
"""Infallible functions."""

_FAILING: _Signatures = {
    (c_void_p, (c_char_p,)): "arv_camera_new",
    (c_char_p, (c_void_p,)): "arv_camera_get_model_name arv_camera_get_vendor_name "
    "arv_gc_feature_node_get_value_as_string",
    (c_int, (c_void_p, c_char_p)): "arv_camera_is_feature_available",
    (c_void_p, (c_void_p, c_char_p, POINTER(c_uint))): "arv_device_dup_available_enumeration_feature_values_as_strings",
    (None, (c_void_p, c_char_p)): "arv_gc_feature_node_set_value_from_string",
    (c_uint, (c_void_p,)): "arv_camera_get_payload",
    (c_void_p, (c_void_p, c_void_p, c_void_p)): "arv_camera_create_stream",
    (None, (c_void_p,)): "arv_camera_start_acquisition arv_camera_stop_acquisition",
}
"""Fallible functions; the place of the error follows the arguments."""

_QUICK: _Signatures = {
    (c_void_p, (c_void_p,)): "arv_stream_try_pop_buffer",
    (c_int, (c_void_p,)): "arv_buffer_get_status",
    (c_uint64, (c_void_p,)): "arv_buffer_get_frame_id arv_buffer_get_timestamp",
    (c_void_p, (c_void_p, POINTER(c_size_t))): "arv_buffer_get_image_data",
    (None, (c_void_p, POINTER(c_int), POINTER(c_int))): "arv_buffer_get_image_padding",
}
"""Functions called for each frame. They keep Python's lock: other threads might hold the lock for 5 ms each time."""


@lru_cache
def aravis() -> Any:
    """Load the library once; return the functions by name, less the prefix "arv_". A failure raises a MediaError."""
    calls = SimpleNamespace()
    try:
        library, quick = ctypes.CDLL("libaravis-0.8.so.0"), ctypes.PyDLL("libaravis-0.8.so.0")
        for source, signatures in ((library, _PLAIN), (quick, _QUICK), (library, _FAILING)):
            for (result, arguments), names in signatures.items():
                for name in names.split():
                    call, can_fail = getattr(source, name), signatures is _FAILING
                    call.restype, call.argtypes = result, (*arguments, c_void_p) if can_fail else arguments
                    setattr(calls, name.removeprefix("arv_"), _checked(calls, call) if can_fail else call)
    except (OSError, AttributeError) as error:
        lacking = f" ({error})" if isinstance(error, AttributeError) else ""
        cure = "'apt-get install libaravis-0.8-0' (Debian, Ubuntu), 'dnf install aravis' (Fedora)"
        raise MediaError(f"GigE and USB3 Vision cameras need the library Aravis 0.8{lacking}: {cure}") from None
    return calls


def _checked(calls: Any, call: Any) -> Callable[..., Any]:
    def checked(*arguments: Any) -> Any:
        failure = c_void_p()
        result = call(*arguments, byref(failure))
        if failure.value:
            # GError: domain and code of 4 bytes each, then the message
            text = c_char_p.from_address(failure.value + 8).value or b"unknown error"
            message = " ".join(_decode(text).split())
            calls.g_error_free(failure)
            raise MediaError(message)
        return result

    return checked


class AravisCamera(FeatureCamera):
    """A camera of GigE Vision or USB3 Vision; see `Camera`."""

    def __init__(self, address: str):
        super().__init__(address)
        self._calls: Any = None
        self._camera = self._device = self._stream = None

    def open(self, settings: CameraSettings) -> CameraForm:
        """Connect and configure the camera; see `Camera`."""
        calls = self._calls = aravis()
        try:
            self._camera = calls.camera_new(self._find_name().encode() or None)
        except MediaError as error:
            camera = f"camera '{self._address}'" if self._address else "camera"
            raise MediaError(f"no {camera} is found by Aravis ({error}); see 'heliograph cameras'") from None
        self._device = calls.camera_get_device(self._camera)
        calls.camera_set_range_check_policy(self._camera, 1)  # values out of range are errors
        vendor, model = calls.camera_get_vendor_name(self._camera), calls.camera_get_model_name(self._camera)
        return self._configure(settings, f"{_decode(vendor)} {_decode(model)}")

    def frames(self, wait_s: float) -> Sequence[Picture]:
        """Return the pictures since the last call; see `Camera`."""
        calls = self._calls
        if self._stream is None:
            self._start()
        wait_us = round(wait_s * 1e6)
        buffer = calls.stream_try_pop_buffer(self._stream) or calls.stream_timeout_pop_buffer(self._stream, wait_us)
        pictures: list[Picture] = []
        while buffer:
            pictures += self._convert(buffer)
            calls.stream_push_buffer(self._stream, buffer)
            buffer = calls.stream_try_pop_buffer(self._stream) if len(pictures) < self.n_buffers else None
        if not pictures:
            self._check_control()
        return pictures

    def close(self) -> None:
        """Stop and release the camera; see `Camera`."""
        if self._stream is not None:
            with contextlib.suppress(MediaError):  # a lost camera does not answer
                self._calls.camera_stop_acquisition(self._camera)
            self._calls.g_object_unref(self._stream)
        if self._camera is not None:
            self._calls.g_object_unref(self._camera)
        self._stream = self._camera = None

    def _find_name(self) -> str:
        """Return the identifier or address to open the camera by.

        A camera on this machine answers on all interfaces; only the address selects the interface of the frames.
        """
        if self._address.startswith("127."):
            return self._address
        for _ in range(3):  # an answer may come late
            self._calls.update_device_list()
            for number in range(self._calls.get_n_devices()):
                name, serial, address = (_device_text(key, number) for key in ("id", "serial_nbr", "address"))
                if self._address in ("", name, serial):
                    return address if address.startswith("127.") else name
        return self._address

    def _has(self, name: str) -> bool:
        return bool(self._calls.camera_is_feature_available(self._camera, name.encode()))

    def _node(self, name: str) -> Any:
        node = self._calls.device_get_feature(self._device, name.encode())
        if node is None:
            raise MediaError(f"it has no feature {name}")
        return node

    def _read(self, name: str) -> Value:
        return _decode(self._calls.gc_feature_node_get_value_as_string(self._node(name)))

    def _write(self, name: str, value: Value) -> None:
        # integer features refuse "3.0"
        text = f"{value:.15g}" if isinstance(value, float) else str(value)
        self._calls.gc_feature_node_set_value_from_string(self._node(name), text.encode())

    def _values(self, name: str) -> list[str]:
        count = c_uint()
        call = self._calls.device_dup_available_enumeration_feature_values_as_strings
        texts = call(self._device, name.encode(), byref(count))
        values = [_decode(text) for text in ctypes.cast(texts, POINTER(c_char_p))[: count.value]]
        self._calls.g_free(texts)
        return values

    def _start(self) -> None:
        calls = self._calls
        try:
            self._stream = calls.camera_create_stream(self._camera, None, None)
            size = calls.camera_get_payload(self._camera)
            if calls.camera_is_gv_device(self._camera):
                # eight frames; the system may grant less (net.core.rmem_max)
                size_name = b"socket-buffer-size"
                calls.g_object_set(self._stream, b"socket-buffer", 0, size_name, max(1 << 20, 8 * size), None)
            for _ in range(self.n_buffers):
                calls.stream_push_buffer(self._stream, calls.buffer_new(size, None))
            calls.camera_start_acquisition(self._camera)
        except MediaError as error:
            raise CameraLostError(str(error)) from None

    def _convert(self, buffer: int) -> list[Picture]:
        """Return the picture in a buffer, if any: the stream may have stopped too early."""
        calls = self._calls
        status = calls.buffer_get_status(buffer)
        if status != 0:  # ARV_BUFFER_STATUS_SUCCESS; 7 is ARV_BUFFER_STATUS_ABORTED
            return [] if status == 7 else [Picture(None)]
        size, right, below = c_size_t(), c_int(), c_int()
        source = calls.buffer_get_image_data(buffer, byref(size))
        calls.buffer_get_image_padding(buffer, byref(right), byref(below))
        data = np.empty(size.value, np.uint8)
        ctypes.memmove(data.ctypes.data, source, size.value)
        number, stamp_ns = calls.buffer_get_frame_id(buffer), calls.buffer_get_timestamp(buffer)
        return [self._picture(data, right.value, number, stamp_ns)]

    def _check_control(self) -> None:
        """Raise a CameraLostError if the camera does not answer."""
        calls = self._calls
        if calls.camera_is_gv_device(self._camera):
            if not calls.gv_device_is_controller(self._device):
                raise CameraLostError("it does not answer")
            return
        try:
            calls.camera_get_payload(self._camera)
        except MediaError as error:
            raise CameraLostError(str(error)) from None


def find(_settings: CameraSettings) -> list[Found]:
    """List the cameras known to Aravis."""
    aravis().update_device_list()
    keys = ("id", "vendor", "model", "protocol", "address")
    cameras = [[_device_text(key, number) for key in keys] for number in range(aravis().get_n_devices())]
    return [Found(name, f"{vendor} {model}, {kind}, {address}") for name, vendor, model, kind, address in cameras]


def _device_text(key: str, number: int) -> str:
    return _decode(getattr(aravis(), f"get_device_{key}")(number))


def _decode(text: bytes | None) -> str:
    return (text or b"").decode(errors="replace")


KIND = CameraKind(AravisCamera, find)  # cameras through Aravis
