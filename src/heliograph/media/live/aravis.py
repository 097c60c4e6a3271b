"""GigE Vision and USB3 Vision cameras by Aravis, called through ctypes."""

import contextlib
import ctypes
from collections.abc import Callable, Sequence
from ctypes import POINTER, byref, c_char_p, c_double, c_int, c_size_t, c_uint, c_uint64, c_void_p
from functools import lru_cache
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.media.live.camera import CameraForm, CameraKind, CameraLostError, Found, Picture
from heliograph.media.live.pixel_formats import PixelFormat, pixel_format
from heliograph.media.live.settings import OFF, Asked, CameraSettings

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


FEWEST_BUFFERS, MOST_BUFFERS = 16, 512
"""Least and most frames that the library holds at a time. Chosen; half a second of a camera's frames between."""

HELD_S = 0.5
"""Time for which frames find room in the library: it keeps one that lacks packets for 0.1 s, and all after it."""

HELD_BYTES = 1 << 28
"""Most bytes of those frames. Chosen: 512 frames of 1024 x 512 pixels."""

SOCKET_FRAMES, LEAST_SOCKET = 8, 1 << 20
"""Frames, and least bytes, that the system keeps of a stream; it may grant less (net.core.rmem_max). Chosen."""


LOOKS = 3
"""Times that a camera is looked for: its answer to one look may come late. Chosen."""

LOOPBACK = "127."
"""How addresses of this very machine begin (RFC 1122, section 3.2.1.3)."""


class AravisCamera:
    """A camera of GigE Vision or USB3 Vision; see `Camera`."""

    def __init__(self, address: str):
        self._address = address
        self._calls: AravisCalls | None = None
        self._camera = self._stream = None
        self._format: PixelFormat | None = None
        self._width = self._height = self._buffers = 0
        self._channel = "luma"

    def open(self, settings: CameraSettings) -> CameraForm:
        """Connect and set the camera; see `Camera`."""
        calls = self._calls = aravis()
        try:
            self._camera = calls.camera_new(self._reached(calls).encode() or None)
        except MediaError as error:
            who = f"camera '{self._address}'" if self._address else "camera"
            raise MediaError(
                f"no {who} is found by Aravis ({error}); 'heliograph cameras' lists what is there"
            ) from None
        calls.camera_set_range_check_policy(self._camera, CHECKED)
        if calls.camera_is_feature_available(self._camera, b"AcquisitionMode"):
            calls.camera_set_acquisition_mode(self._camera, CONTINUOUS)
        asked = Asked()
        self._set(settings, asked)
        return self._form(settings, asked)

    def frames(self, wait_s: float) -> Sequence[Picture]:
        """Return the pictures that came; see `Camera`."""
        calls = self._opened
        if self._stream is None:
            self._start()
        buffer = calls.stream_try_pop_buffer(self._stream)
        if buffer is None:
            buffer = calls.stream_timeout_pop_buffer(self._stream, round(wait_s * 1e6))
        pictures = []
        while buffer is not None:
            picture = self._picture(buffer)
            calls.stream_push_buffer(self._stream, buffer)
            if picture is not None:
                pictures.append(picture)
            buffer = calls.stream_try_pop_buffer(self._stream) if len(pictures) < self._buffers else None
        if not pictures:
            self._check_control()
        return pictures

    def close(self) -> None:
        """Stop the camera and let go of it; see `Camera`."""
        calls = self._calls
        if calls is None:
            return
        if self._stream is not None:
            with contextlib.suppress(MediaError):  # it may not answer any more
                calls.camera_stop_acquisition(self._camera)
            calls.g_object_unref(self._stream)
        if self._camera is not None:
            calls.g_object_unref(self._camera)
        self._stream = self._camera = None

    @property
    def _opened(self) -> AravisCalls:
        assert self._calls is not None
        return self._calls

    def _reached(self, calls: AravisCalls) -> str:
        """What the camera is called to open it.

        One on this very machine answers on all its interfaces; it is called by its address, or its frames would be
        waited for on the wrong one.
        """
        if self._address.startswith(LOOPBACK):
            return self._address
        for _ in range(LOOKS):
            calls.update_device_list()
            for number in range(calls.get_n_devices()):
                names = [_decoded(call(number)) for call in (calls.get_device_id, calls.get_device_serial_nbr)]
                address = _decoded(calls.get_device_address(number))
                if self._address in ("", *names) and address.startswith(LOOPBACK):
                    return address
                if self._address in ("", *names):
                    return names[0]
        return self._address

    def _set(self, settings: CameraSettings, asked: Asked) -> None:
        """Set what is asked for. The pixels come first, as rates depend on them; a feature of its own comes last."""
        calls, camera = self._opened, self._camera
        if settings.pixel_format is not None:
            with asked.setting("pixel_format", settings.pixel_format, self._formats):
                calls.camera_set_pixel_format_from_string(camera, settings.pixel_format.encode())
        if settings.region is not None:
            with asked.setting("region", settings.region):
                calls.camera_set_region(camera, *settings.region)
        if settings.exposure_us is not None:
            with asked.setting("exposure_us", settings.exposure_us):
                if calls.camera_is_exposure_auto_available(camera):
                    calls.camera_set_exposure_time_auto(camera, AUTO_OFF)
                calls.camera_set_exposure_time(camera, settings.exposure_us)
        if settings.gain is not None:
            with asked.setting("gain", settings.gain):
                if calls.camera_is_gain_auto_available(camera):
                    calls.camera_set_gain_auto(camera, AUTO_OFF)
                calls.camera_set_gain(camera, settings.gain)
        if settings.rate_hz is not None:
            with asked.setting("rate_hz", settings.rate_hz):
                calls.camera_set_frame_rate(camera, settings.rate_hz)
        if settings.trigger is not None:
            with asked.setting("trigger", settings.trigger):
                if settings.triggered:
                    calls.camera_set_trigger(camera, settings.trigger.encode())
                else:
                    calls.camera_clear_triggers(camera)
        for key, value in settings.features.items():
            with asked.setting(key, value):
                calls.device_set_features_from_string(calls.camera_get_device(camera), f"{key}={value}".encode())

    def _form(self, settings: CameraSettings, asked: Asked) -> CameraForm:
        """Read back what the camera made of it."""
        calls = self._opened
        x, y, self._width, self._height = self._region()
        name = self._text("camera_get_pixel_format_as_string")
        self._format, self._channel = self._read_format(name), settings.channel
        asked.got("pixel_format", settings.pixel_format, name)
        asked.got("region", settings.region, (x, y, self._width, self._height))
        rate_hz = 0.0
        if calls.camera_is_frame_rate_available(self._camera):
            rate_hz = calls.camera_get_frame_rate(self._camera)
            asked.got("rate_hz", settings.rate_hz, rate_hz)
        if calls.camera_is_exposure_time_available(self._camera):
            asked.got("exposure_us", settings.exposure_us, calls.camera_get_exposure_time(self._camera))
        if calls.camera_is_gain_available(self._camera):
            asked.got("gain", settings.gain, calls.camera_get_gain(self._camera))
        self._read_trigger(settings, asked)
        for key, value in settings.features.items():
            asked.got(key, value, self._feature(key))
        frame = max(1, calls.camera_get_payload(self._camera))
        most = max(FEWEST_BUFFERS, min(MOST_BUFFERS, HELD_BYTES // frame))
        self._buffers = min(most, max(FEWEST_BUFFERS, round(HELD_S * (rate_hz or MOST_BUFFERS))))
        model = f"{self._text('camera_get_vendor_name')} {self._text('camera_get_model_name')}"
        return CameraForm(
            self._width,
            self._height,
            self._format.bits,
            rate_hz or None,
            model,
            asked.settings,
            tuple(asked.departures),
        )

    def _region(self) -> tuple[int, int, int, int]:
        places = [c_int() for _ in range(4)]
        self._opened.camera_get_region(self._camera, *map(byref, places))
        x, y, width, height = (place.value for place in places)
        return x, y, width, height

    def _read_format(self, name: str) -> PixelFormat:
        try:
            return pixel_format(name)
        except MediaError as error:
            raise MediaError(f"{error}; this camera has {', '.join(self._formats())}") from None

    def _formats(self) -> list[str]:
        return self._opened.texts("camera_dup_available_pixel_formats_as_strings", self._camera)

    def _read_trigger(self, settings: CameraSettings, asked: Asked) -> None:
        if not self._opened.camera_is_feature_available(self._camera, b"TriggerMode"):
            return
        on = self._feature("TriggerMode") == "On"
        asked.got("trigger", settings.trigger, self._feature("TriggerSource") if on else OFF)

    def _feature(self, name: str) -> str:
        """A feature's value as text."""
        calls = self._opened
        node = calls.device_get_feature(calls.camera_get_device(self._camera), name.encode())
        if node is None:
            raise MediaError(f"the camera has no feature {name}")
        return _decoded(calls.gc_feature_node_get_value_as_string(node))

    def _text(self, call: str) -> str:
        return _decoded(getattr(self._opened, call)(self._camera))

    def _start(self) -> None:
        calls = self._opened
        try:
            self._stream = calls.camera_create_stream(self._camera, None, None)
            size = calls.camera_get_payload(self._camera)
            if calls.camera_is_gv_device(self._camera):
                room = max(LEAST_SOCKET, SOCKET_FRAMES * size)
                calls.set_property(self._stream, b"socket-buffer", 0, b"socket-buffer-size", room, None)
            for _ in range(self._buffers):
                calls.stream_push_buffer(self._stream, calls.buffer_new(size, None))
            calls.camera_start_acquisition(self._camera)
        except MediaError as error:
            raise CameraLostError(str(error)) from None

    def _picture(self, buffer: int) -> Picture | None:
        """What a buffer holds; None of one that was on its way at the end."""
        calls = self._opened
        status = calls.buffer_get_status(buffer)
        if status != COMPLETE:
            return None if status == ABORTED else Picture(None)
        size, right, below = c_size_t(), c_int(), c_int()
        held = calls.buffer_get_image_data(buffer, byref(size))
        calls.buffer_get_image_padding(buffer, byref(right), byref(below))
        assert self._format is not None
        if size.value < self._format.size(self._width, self._height, right.value):
            return Picture(None)  # whole, it says, and empty
        data = np.empty(size.value, np.uint8)
        ctypes.memmove(data.ctypes.data, held, size.value)
        pixels = self._format.pixels(data, self._width, self._height, right.value, self._channel)
        return Picture(pixels, calls.buffer_get_frame_id(buffer), calls.buffer_get_timestamp(buffer) or None)

    def _check_control(self) -> None:
        """Notice that the camera is gone."""
        calls = self._opened
        if calls.camera_is_gv_device(self._camera):
            if not calls.gv_device_is_controller(calls.camera_get_device(self._camera)):
                raise CameraLostError("it does not answer")
            return
        try:
            calls.camera_get_payload(self._camera)
        except MediaError as error:
            raise CameraLostError(str(error)) from None


def find(_settings: CameraSettings) -> list[Found]:
    """List the cameras that Aravis finds."""
    calls = aravis()
    calls.update_device_list()

    def said(call: str, number: int) -> str:
        return _decoded(getattr(calls, call)(number))

    return [
        Found(
            said("get_device_id", number),
            f"{said('get_device_vendor', number)} {said('get_device_model', number)}, "
            f"{said('get_device_protocol', number)}, {said('get_device_address', number)}",
        )
        for number in range(calls.get_n_devices())
    ]


def _decoded(text: bytes | None) -> str:
    return (text or b"").decode(errors="replace")


KIND = CameraKind(AravisCamera, find)
"""Cameras through Aravis."""
