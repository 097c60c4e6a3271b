"""The calls of libaravis 0.8 that are needed here, by ctypes: GObject's own Python package comes without wheels."""

import ctypes
from collections.abc import Callable
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_uint64, c_void_p
from functools import lru_cache
from typing import Any

from heliograph.base.errors import MediaError

LIBRARY = "libaravis-0.8.so.0"
"""The library as the loader knows it."""

COMPLETE = 0
"""Status of a buffer that came whole (ARV_BUFFER_STATUS_SUCCESS)."""

ABORTED = 7
"""Status of a buffer that was on its way when the stream was stopped (ARV_BUFFER_STATUS_ABORTED)."""

CHECKED = 1
"""Policy by which values beyond a feature's bounds are an error (ARV_RANGE_CHECK_POLICY_ENABLE)."""

CONTINUOUS = 0
"""The camera goes on until it is stopped (ARV_ACQUISITION_MODE_CONTINUOUS)."""

AUTO_OFF = 0
"""A feature is not set by the camera itself (ARV_AUTO_OFF)."""


class _GError(ctypes.Structure):
    """An error of GLib."""

    _fields_ = (("domain", ctypes.c_uint32), ("code", c_int), ("message", c_char_p))


_PLAIN: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_update_device_list": (None, ()),
    "arv_get_n_devices": (c_uint, ()),
    "arv_get_device_id": (c_char_p, (c_uint,)),
    "arv_get_device_serial_nbr": (c_char_p, (c_uint,)),
    "arv_get_device_vendor": (c_char_p, (c_uint,)),
    "arv_get_device_model": (c_char_p, (c_uint,)),
    "arv_get_device_protocol": (c_char_p, (c_uint,)),
    "arv_get_device_address": (c_char_p, (c_uint,)),
    "arv_camera_get_device": (c_void_p, (c_void_p,)),
    "arv_camera_is_gv_device": (c_int, (c_void_p,)),
    "arv_camera_set_range_check_policy": (None, (c_void_p, c_int)),
    "arv_gv_device_is_controller": (c_int, (c_void_p,)),
    "arv_device_get_feature": (c_void_p, (c_void_p, c_char_p)),
    "arv_buffer_new": (c_void_p, (c_size_t, c_void_p)),
    "arv_stream_push_buffer": (None, (c_void_p, c_void_p)),
    "arv_stream_timeout_pop_buffer": (c_void_p, (c_void_p, c_uint64)),
    "g_object_unref": (None, (c_void_p,)),
    "g_free": (None, (c_void_p,)),
    "g_error_free": (None, (c_void_p,)),
}
"""Calls that cannot fail: what each returns, and what it takes."""

_FAILING: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_camera_new": (c_void_p, (c_char_p,)),
    "arv_camera_get_model_name": (c_char_p, (c_void_p,)),
    "arv_camera_get_vendor_name": (c_char_p, (c_void_p,)),
    "arv_camera_is_feature_available": (c_int, (c_void_p, c_char_p)),
    "arv_camera_is_exposure_time_available": (c_int, (c_void_p,)),
    "arv_camera_is_exposure_auto_available": (c_int, (c_void_p,)),
    "arv_camera_is_gain_available": (c_int, (c_void_p,)),
    "arv_camera_is_gain_auto_available": (c_int, (c_void_p,)),
    "arv_camera_is_frame_rate_available": (c_int, (c_void_p,)),
    "arv_camera_set_acquisition_mode": (None, (c_void_p, c_int)),
    "arv_camera_set_pixel_format_from_string": (None, (c_void_p, c_char_p)),
    "arv_camera_get_pixel_format_as_string": (c_char_p, (c_void_p,)),
    "arv_camera_dup_available_pixel_formats_as_strings": (c_void_p, (c_void_p, POINTER(c_uint))),
    "arv_camera_set_region": (None, (c_void_p, c_int, c_int, c_int, c_int)),
    "arv_camera_get_region": (None, (c_void_p, *4 * (POINTER(c_int),))),
    "arv_camera_set_exposure_time_auto": (None, (c_void_p, c_int)),
    "arv_camera_set_exposure_time": (None, (c_void_p, c_double)),
    "arv_camera_get_exposure_time": (c_double, (c_void_p,)),
    "arv_camera_set_gain_auto": (None, (c_void_p, c_int)),
    "arv_camera_set_gain": (None, (c_void_p, c_double)),
    "arv_camera_get_gain": (c_double, (c_void_p,)),
    "arv_camera_set_frame_rate": (None, (c_void_p, c_double)),
    "arv_camera_get_frame_rate": (c_double, (c_void_p,)),
    "arv_camera_set_trigger": (None, (c_void_p, c_char_p)),
    "arv_camera_clear_triggers": (None, (c_void_p,)),
    "arv_camera_get_string": (c_char_p, (c_void_p, c_char_p)),
    "arv_device_set_features_from_string": (c_int, (c_void_p, c_char_p)),
    "arv_gc_feature_node_get_value_as_string": (c_char_p, (c_void_p,)),
    "arv_camera_get_payload": (c_uint, (c_void_p,)),
    "arv_camera_create_stream": (c_void_p, (c_void_p, c_void_p, c_void_p)),
    "arv_camera_start_acquisition": (None, (c_void_p,)),
    "arv_camera_stop_acquisition": (None, (c_void_p,)),
}
"""Calls that may fail: what each returns, and what it takes before the place of its error."""

_QUICK: dict[str, tuple[Any, tuple[Any, ...]]] = {
    "arv_stream_try_pop_buffer": (c_void_p, (c_void_p,)),
    "arv_buffer_get_status": (c_int, (c_void_p,)),
    "arv_buffer_get_frame_id": (c_uint64, (c_void_p,)),
    "arv_buffer_get_timestamp": (c_uint64, (c_void_p,)),
    "arv_buffer_get_image_data": (c_void_p, (c_void_p, POINTER(c_size_t))),
    "arv_buffer_get_image_padding": (None, (c_void_p, POINTER(c_int), POINTER(c_int))),
}
"""Calls for each frame, which return at once: Python's lock is not handed on between them, as another thread might keep
it for 5 ms each time."""


class AravisCalls:
    """The library's functions, by their names without "arv_"; those that may fail raise a MediaError."""

    def __init__(self, path: str = LIBRARY):
        library, quick = ctypes.CDLL(path), ctypes.PyDLL(path)
        self._calls: dict[str, Callable[..., Any]] = {}
        for name, (returned, taken) in _PLAIN.items():
            self._add(name, _typed(library, name, returned, taken))
        for name, (returned, taken) in _QUICK.items():
            self._add(name, _typed(quick, name, returned, taken))
        for name, (returned, taken) in _FAILING.items():
            self._add(name, self._checked(_typed(library, name, returned, (*taken, c_void_p))))
        # takes names and values of any number, up to a null
        self.set_property = _typed(
            library, "g_object_set", None, (c_void_p, c_char_p, c_int, c_char_p, c_int, c_void_p)
        )

    def __getattr__(self, name: str) -> Callable[..., Any]:
        try:
            return self._calls[name]
        except KeyError:
            raise AttributeError(name) from None

    def texts(self, call: str, *arguments: Any) -> list[str]:
        """Return the texts that a call returns as an array of its own."""
        count = c_uint()
        held = self._calls[call](*arguments, byref(count))
        found = [text.decode(errors="replace") for text in ctypes.cast(held, POINTER(c_char_p))[: count.value]]
        self.g_free(held)
        return found

    def _add(self, name: str, call: Callable[..., Any]) -> None:
        self._calls[name.removeprefix("arv_")] = call

    def _checked(self, call: Any) -> Callable[..., Any]:
        def checked(*arguments: Any) -> Any:
            held = c_void_p()
            found = call(*arguments, byref(held))
            if held:
                text = ctypes.cast(held, POINTER(_GError)).contents.message or b"unknown error"
                message = " ".join(text.decode(errors="replace").split())
                self.g_error_free(held)
                raise MediaError(message)
            return found

        return checked


def _typed(library: Any, name: str, returned: Any, taken: tuple[Any, ...]) -> Any:
    call = getattr(library, name)
    call.restype, call.argtypes = returned, taken
    return call


@lru_cache
def aravis() -> AravisCalls:
    """Return the library, loaded once."""
    try:
        return AravisCalls()
    except (OSError, AttributeError) as error:
        lacking = f" ({error})" if isinstance(error, AttributeError) else ""
        raise MediaError(
            f"GigE and USB3 Vision cameras need the library Aravis 0.8{lacking}: 'apt-get install libaravis-0.8-0' "
            "(Debian, Ubuntu), 'dnf install aravis' (Fedora)"
        ) from None
