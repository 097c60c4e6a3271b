"""Reused or shared pixel buffers give the same packets as separate arrays."""

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
import pytest
from scenes import film, link
from screen_films import Phone, phone_frames
from screen_light import shown

from heliograph.base.frames import Frame, Pixels
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.receive import make_receiver, receive_frames
from heliograph.web.sending import screen_settings, sending_of

RING = 6
"""Frames in the camera's ring buffer."""


@cache
def small_film(receiver: str) -> tuple[LinkSettings, tuple[Frame, ...]]:
    """Return a film slightly longer than one packet."""
    if receiver != "screen":
        settings = link(f"receive.receiver={receiver}", "signal.data_pairs=24", distance_m=30.0)
        return settings, tuple(film(settings, 75, 3, 12))
    grabs = shown(sending_of(b"Hello", None, 8, 15.0), 4.5, cell_px=8)
    seen = phone_frames(grabs, Phone(width=120, height=100, side_px=64.0, blur_px=0.8, seed=5))
    return screen_settings(8, 15.0), tuple(Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(seen))


def one_array(frames: tuple[Frame, ...]) -> Iterator[Pixels]:
    image = np.empty_like(frames[0].pixels)
    for frame in frames:
        image[:] = frame.pixels
        yield image
    image[:] = 0


def ring(frames: tuple[Frame, ...]) -> Iterator[Pixels]:
    """Yield read-only views into a ring buffer."""
    buffer = bytearray(RING * frames[0].pixels.nbytes)
    slots = np.frombuffer(buffer, np.uint8).reshape(RING, *frames[0].pixels.shape)
    views = np.frombuffer(memoryview(buffer).toreadonly(), np.uint8).reshape(slots.shape)
    for k, frame in enumerate(frames):
        slots[k % RING] = frame.pixels
        yield views[k % RING]


def flipped(frames: tuple[Frame, ...]) -> Iterator[Pixels]:
    """Yield flipped views of a single bottom-up image."""
    image = np.empty_like(frames[0].pixels)
    for frame in frames:
        image[:] = frame.pixels[::-1]
        yield image[::-1]


def columns_first(frames: tuple[Frame, ...]) -> Iterator[Pixels]:
    image = np.empty(frames[0].pixels.shape, np.uint8, order="F")
    for frame in frames:
        image[:] = frame.pixels
        yield image


def a_colour(frames: tuple[Frame, ...]) -> Iterator[Pixels]:
    """Yield the green channel of a colour image: every third byte."""
    image = np.zeros((*frames[0].pixels.shape, 3), np.uint8)
    for frame in frames:
        image[..., 1] = frame.pixels
        yield image[..., 1]


def unmasked(frames: tuple[Frame, ...]) -> Iterator[Pixels]:
    image = np.ma.masked_array(np.empty_like(frames[0].pixels))
    for frame in frames:
        image[:] = frame.pixels
        yield image


@pytest.mark.slow
@pytest.mark.parametrize("share", [one_array, ring, flipped, columns_first, a_colour, unmasked])
@pytest.mark.parametrize("receiver", ["plain", "soft", "screen"])
def test_packets_are_those_of_frames_with_arrays_of_their_own(
    receiver: str, share: Callable[[tuple[Frame, ...]], Iterator[Pixels]]
) -> None:
    settings, frames = small_film(receiver)
    shared = (Frame(k, one.time_s, pixels) for k, (one, pixels) in enumerate(zip(frames, share(frames), strict=True)))
    packets = list(receive_frames(shared, settings.signal, settings.receive))
    assert [packet.status for packet in packets][:1] == ["ok"]
    alone = next(receive_frames(frames, settings.signal, settings.receive))
    for layer, words in packets[0].layers.items():
        assert [word.status for word in words] == [word.status for word in alone.layers[layer]]
        assert all(np.array_equal(one.bits, other.bits) for one, other in zip(words, alone.layers[layer], strict=True))


@pytest.mark.parametrize(("receiver", "preset"), [("plain", "static"), ("soft", "static"), ("screen", "phone")])
def test_no_array_of_the_caller_is_kept(receiver: str, preset: str) -> None:
    settings = load_settings(preset, None, [f"receive.receiver={receiver}"])
    live = make_receiver(settings.signal, settings.receive)
    rng, fresh, refilled = np.random.default_rng(1), list[Frame](), np.empty((48, 64), np.uint8)
    period_s = 1 / settings.channel.camera.fps
    for k in range(20):
        refilled[:] = rng.integers(0, 255, refilled.shape)
        fresh.append(Frame(k, k * period_s, refilled))
        list(live.push(fresh[-1]))
    kept = _arrays(live, set())
    assert any(one.shape == refilled.shape for one in kept), "the test sees what is kept"
    assert not any(np.shares_memory(one, refilled) for one in kept)


def _arrays(value: object, known: set[int]) -> list[np.ndarray]:
    """Return all arrays reachable from a package object."""
    if id(value) in known:
        return []
    known.add(id(value))
    if isinstance(value, np.ndarray):
        return [value]
    held: list[object] = []
    if isinstance(value, dict):
        held = list(value.values())
    elif isinstance(value, (list, tuple, set)) or type(value).__name__ == "deque":
        held = list(value)  # type: ignore[call-overload]
    elif type(value).__module__.startswith("heliograph"):
        slots = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
        held = [*getattr(value, "__dict__", {}).values(), *(getattr(value, name, None) for name in slots)]
    return [array for one in held for array in _arrays(one, known)]
