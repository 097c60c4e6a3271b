"""Hostile settings text (deep, long or huge) and impossible scenes fail at once with a one-line error."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from heliograph.base.config import from_mapping
from heliograph.base.errors import MediaError, SettingsError
from heliograph.base.files import read_bounded, room_for
from heliograph.base.toml_text import parse_assignment, parse_toml, parse_value
from heliograph.cli.options import read_toml
from heliograph.link.settings import LinkSettings, load_settings

TEXTS = {
    "a = " + "[" * 50_000: "more than 32 deep",
    "a = " + "[" * 200 + "]" * 200: "more than 32 deep",
    ".".join("a" * 50_000) + " = 1": "more than 32 deep",
    "v.w = {x = 'a.b', " + " . ".join(["'a.b'"] * 40_000) + " = 1}": "more than 32 deep",
    "a = " + "1" * 5000: "more than 64 bits",
    "a = 9223372036854775808": "more than 64 bits",
    "a = -9223372036854775809": "more than 64 bits",
}


@pytest.mark.parametrize("text", TEXTS, ids=lambda text: text[:12])
def test_text_of_no_settings(text: str) -> None:
    with pytest.raises(SettingsError, match=TEXTS[text]):
        parse_toml(text)
    with pytest.raises(SettingsError, match=TEXTS[text]):
        parse_assignment(text.replace(" = ", "="))
    assert (parse_value("9223372036854775807"), parse_value("-9223372036854775808")) == ((1 << 63) - 1, -(1 << 63))


@pytest.mark.parametrize("quotes", ['"', "'", '"""', "'''", '\\""""'])
def test_dots_that_part_no_key(quotes: str) -> None:
    dots = "." * 40_000
    opened = quotes.lstrip("\\")[:3]  # an escaped or fourth closing quote belongs to the string
    text = f"# {dots}\na.b = {opened}{dots}{quotes} # {dots}\nc = [{'1.5, ' * 40}]"
    assert parse_toml(text)["a"]["b"].startswith(dots)
    assert (parse_value(dots), parse_value(f"1\n{dots}")) == (dots, f"1\n{dots}")
    with pytest.raises(SettingsError, match="more than 32 deep"):
        parse_toml(f"{text}\n{'.'.join('d' * 34)} = 1")


def loading(*changes: str) -> None:
    load_settings("static", None, list(changes))


VALUES = {
    "channel.duration_s=1e308": r"equal to 3600\b", "channel.camera.pixel_m=1e-300": r"equal to 0.0000001\b",
    "channel.camera.start_s=-1e9": r"equal to -60\b", "channel.arrays.0.vx_m_s=1e300": r"equal to 1000\b",
    "channel.distance_m=1e300": r"equal to 10000\b", "channel.camera.fps=1e-300": r"equal to 0.1\b",
    "channel.speed_profile=[[0, 1e300]]": r"equal to 100\b",
    "receive.calibration.pixel_m=1e-300": r"equal to 0.0000001\b",
    "receive.track.coast_patterns=1e300": r"equal to 1000000\b",
    "channel.camera.focal_m=10 channel.camera.pixel_m=1e-6": r"at most 1e.06 pixels of pixel_m",
}  # fmt: skip


@pytest.mark.parametrize("changes", VALUES)
def test_values_that_no_scene_has(changes: str) -> None:
    with pytest.raises(SettingsError, match=VALUES[changes]):
        loading(*([changes] if "[" in changes else changes.split()))


TRUE: list[Any] = [
    "channel.distance_m=true", "channel.camera.width=true", "channel.arrays=[{x_m = true}]", "receive.receiver=false",
    "channel.duration_s=true", "transmit.identities=[true]", "channel.speed_profile=[[0, true]]",
    "signal.rate.high=true",
    {"channel": {"distance_m": np.bool_(True)}}, {"channel": {"distance_m": np.array(True)}},
    {"transmit": {"identities": [np.bool_(True)]}}, {"transmit": {"identities": np.array([True])}},
]  # fmt: skip


@pytest.mark.parametrize("change", TRUE, ids=str)
def test_true_is_no_number(change: Any) -> None:
    over, assignments = (None, [change]) if isinstance(change, str) else (change, ())
    with pytest.raises(SettingsError, match="a number or text, not true or false"):
        load_settings("static", over, assignments)


def test_numbers_of_numpy_are_numbers() -> None:
    camera = {"fps": np.float32(500), "width": np.int64(64), "gaps": np.bool_(False)}
    settings = load_settings("static", {"channel": {"camera": camera}, "transmit": {"identities": np.array([3])}})
    found = settings.channel.camera
    assert (found.fps, found.width, found.gaps, settings.transmit.identities) == (500, 64, False, (3,))


def test_an_array_behind_the_camera() -> None:
    behind = "channel.arrays.0.z_offset_m=-60"
    message = r"array 0 lies 10 m behind the camera.*raise channel\.arrays\.0\.z_offset_m"
    with pytest.raises(SettingsError, match=message):
        loading(behind)
    loading(behind, "channel.arrays.0.vz_m_s=20")  # the array overtakes the camera


NEAR = ("channel.distance_m=1", "channel.camera.focal_m=1", "channel.camera.pixel_m=1e-6")


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_fast_array_before_a_long_lens(axis: str) -> None:
    fast = f"channel.arrays.0.v{axis}_m_s="
    says = r"array 0 moves 1e\+06 px in the image within an exposure, at most 1000; lower channel\.arrays\.0\.vx_m_s"
    with pytest.raises(SettingsError, match=says):
        loading(*NEAR, f"{fast}1000")
    loading(*NEAR, f"{fast}0.99")
    loading(f"{fast}1000")  # lens of the reference link at 50 m


UNSEEN = {
    "channel.arrays.0.start_s=-60": r"array 0 shows 6e\+07 patterns before the first frame.*arrays\.0\.start_s",
    "channel.camera.start_s=60": r"6e\+07 patterns before.*lower channel\.camera\.start_s",
    "channel.camera.fps=0.1": r"1e\+07 patterns from frame to frame, at most 1e\+06; raise channel\.camera\.fps",
}


@pytest.mark.parametrize("change", UNSEEN)
def test_patterns_that_no_frame_shows(change: str) -> None:
    with pytest.raises(SettingsError, match=UNSEEN[change]):
        loading("signal.pattern_period_s=1e-6", "channel.camera.exposure_s=1e-6", change)
    loading(change)  # at the reference link's period


@pytest.mark.parametrize(("key", "says"), [
    ("channel.foo", "known are arrays, background, camera,"), ("channel.camera.iris", "known are blur_px, clock_ppm,"),
    ("signal.flavour", "known are code,"), ("verbose", "known are channel, receive, signal, transmit"),
    ("channel.speed", r"did you mean 'channel\.speed_m_s'"), ("distanse_m", r"did you mean 'channel\.distance_m'"),
    ("chanel.distance_m", r"did you mean 'channel'"), ("channel.arrays.0.x", r"did you mean 'channel\.arrays\.0\.x_m'"),
    ("k" * 100_000, "known are"), ("receive.decode.beside", r"it is called 'receive\.decode\.in_background' now"),
    ("receive.own", r"it is called 'receive\.custom' now"),
], ids=lambda text: text[:20])  # fmt: skip
def test_no_key_is_proposed_that_is_far_off(key: str, says: str) -> None:
    with pytest.raises(SettingsError, match=says) as caught:
        loading(f"{key}=1")
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize("value", ["x" * 100_000, ["y"] * 10_000, "a\nb"], ids=lambda value: str(value)[:6])
@pytest.mark.parametrize("key", ["channel.distance_m", "signal.slot_order", "receive.receiver"])
def test_a_message_quotes_little(key: str, value: Any) -> None:
    part, name = key.split(".")
    with pytest.raises(SettingsError, match=r"^.{,499}$"):
        from_mapping(LinkSettings, {part: {name: value}})


def test_a_file_is_read_up_to_a_bound(tmp_path: Path) -> None:
    file, pipe = tmp_path / "a", tmp_path / "pipe"
    file.write_bytes(b"1234")
    os.mkfifo(pipe)
    assert read_bounded(file, 4) == b"1234"
    for path, says in ((file, "longer than 3 bytes; cut it"), (Path("/dev/zero"), "longer than 3 bytes"),
                       (pipe, "a pipe that nobody writes to")):  # fmt: skip
        with pytest.raises(OSError, match=says):
            read_bounded(path, 3, "cut it")
    taken, given = os.pipe()
    os.write(given, b"123")
    os.close(given)
    assert read_bounded(Path(f"/dev/fd/{taken}"), 3) == b"123"
    os.close(taken)


def test_settings_may_begin_with_a_mark_of_the_order_of_bytes(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_bytes("\ufeff[channel]\ndistance_m = 3\n".encode())
    assert read_toml(file) == {"channel": {"distance_m": 3}}


def test_missing_disk_space_is_reported_in_advance(tmp_path: Path) -> None:
    room_for(tmp_path / "a", 1)
    room_for(tmp_path / "none" / "a", 1 << 80)
    with pytest.raises(MediaError, match=r"it takes 1,000,000,000\.0 GB, and .* are free; write less"):
        room_for(tmp_path / "a", 10**18)
