"""Screen reception: phone rates, rotation, unknown rates, other sources, and films without a screen."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
from recorder import Recorder
from scenes import received, statuses, words_of
from screen_films import Grabs, Phone, phone_frames
from screen_light import shown

import heliograph
from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.link.film import write_film
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive.events import DecodeEvent, DetectEvent, ExtractEvent, LostEvent, TrackEvent, UnseenEvent
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame
from heliograph.receive.screen.cells import SAMPLES_PER_S, SearchBudget
from heliograph.signal.block import Block
from heliograph.signal.fountain.files import FileGatherer, SentFile, WholeFile
from heliograph.signal.settings import LAYERS
from heliograph.web.sending import screen_settings, sending_of


def link(preset: str, packets: float, *changes: str, rows: int = 144) -> LinkSettings:
    """Return a link with an array of 0.57 `rows` in a small frame; the readout time of all rows is unchanged."""
    base, pixel_m = load_settings(preset), 2.97e-3 / rows
    small = (
        f"channel.camera.width={16 * rows // 9}",
        f"channel.camera.height={rows}",
        f"channel.camera.row_time_s={base.channel.camera.row_time_s * base.channel.camera.height / rows}",
        f"channel.camera.pixel_m={pixel_m}",
        f"receive.calibration.pixel_m={pixel_m}",
        "channel.distance_m=0.75",
        f"channel.duration_s={packets * base.signal.packet_s}",
    )
    return load_settings(preset, None, [*small, *changes])


def frames(settings: LinkSettings, seed: int = 3) -> list[Frame]:
    return [frame for frame, _ in simulate(settings, default_messages(settings), seed)]


@cache
def phone_60() -> tuple[LinkSettings, list[Frame]]:
    settings = link("phone-60", 1.2)
    return settings, frames(settings)


@pytest.mark.parametrize("preset", ["phone", "phone-60", "phone-240"])
@pytest.mark.slow
def test_phones_of_any_rate_read_a_screen(preset: str) -> None:
    settings = link(preset, 1.4 if preset == "phone-240" else 1.2)
    packets = received(phone_60()[1] if preset == "phone-60" else frames(settings), settings)
    assert packets[0].status == "ok"
    assert packets[0].format.mode == "short"
    assert packets[0].distance_m == pytest.approx(0.75, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("modes", [("single",), ("short", "single"), ("single", "short")])
def test_packets_without_inverses_are_read(modes: tuple[str, ...]) -> None:
    formats = [f"transmit.formats=[{', '.join(f'{{mode={mode!r}}}' for mode in modes)}]"]
    settings = link("phone-60", 2.2, "channel.camera.gain_swing=0.1", "channel.emitter.all_on=0.8", *formats)
    packets = received(frames(settings), settings)
    assert statuses(packets)[:2] == ["ok", "ok"]
    assert [packet.format.mode for packet in packets[:2]] == [*modes, *modes][:2]
    assert len(packets[0].layers["low"][0].raw) == (1 if modes[0] == "short" else 2) * 13 * 64


@pytest.mark.slow
def test_file_is_received_from_8_by_8_cells_at_an_unknown_rate_and_packet_length() -> None:
    file, files, whole = SentFile("a.txt", bytes(range(50))), FileGatherer(), list[WholeFile]()
    form = [f"transmit.formats.0.{layer}=3/4" for layer in LAYERS]
    settings = link("phone-60", 3.3, "signal.side=8", "channel.emitter.pitch_m=0.04", *form, rows=90)
    film = [frame for frame, _ in simulate(settings, [{layer: [file] for layer in LAYERS}], 3)]
    other = replace(settings, signal=replace(settings.signal, pattern_period_s=0.1, data_pairs=48))
    for packet in received(film, other):
        for word in words_of(packet):
            if word.block is not None and not isinstance(word.block, Block):
                progress = files.add(word.block)
                whole += [progress.whole] if progress is not None and progress.whole is not None else []
    assert [(found.name, found.data) for found in whole] == [(file.name, file.data)]


@pytest.mark.slow
def test_compressed_phone_film_is_read(tmp_path: Path) -> None:
    path, recorder = tmp_path / "phone.mp4", Recorder()
    settings = link("phone-60", 1.2, "channel.emitter.backlight_hz=240", "channel.emitter.backlight_duty=0.6")
    write_film(path, settings, default_messages(settings), 3, mbit_s=4)
    with heliograph.open_film(path) as film:
        packets = received(film, link("phone-60", 1.2), recorder)
    assert statuses(packets) == ["ok"]
    others = [type(event) for event in recorder.events if not isinstance(event, TrackEvent | ExtractEvent)]
    assert others == [DetectEvent, DecodeEvent, LostEvent]
    pitches = [tracked.state.pose.pitch for tracked in recorder.tracked]
    assert len(pitches) > 30
    assert pitches == pytest.approx([82.4 / 16] * len(pitches), rel=0.1)
    cuts, (decoded,) = recorder.of(ExtractEvent), recorder.of(DecodeEvent)
    # the first pairs may end before the header is decoded
    assert [cut.number for cut in cuts][-9:] == list(range(4, 13))
    assert decoded.luminances is not None
    for cut in cuts[1:]:
        first, second = (_cells(frame, pose) for frame, pose in zip(cut.frames, cut.poses, strict=True))
        assert np.corrcoef((first - second).ravel(), decoded.luminances[cut.number].ravel())[0, 1] > 0.7


def _cells(frame: AnyFrame, pose: Pose) -> Floats:
    places = np.rint(pose.leds(16) - frame.origin).astype(int)
    return np.asarray(frame.pixels[places[..., 1], places[..., 0]], float)


@pytest.mark.slow
def test_repeated_frames_cost_no_packet() -> None:
    settings, film = phone_60()
    copies = [replace(frame, time_s=frame.time_s + 0.003) for frame in film[::9]]
    repeated = sorted([*film, *copies], key=lambda frame: frame.time_s)
    assert statuses(received(repeated, settings)) == ["ok"]


@pytest.mark.slow
def test_noise_is_not_taken_for_an_array() -> None:
    rng, settings = np.random.default_rng(1), load_settings("phone")
    film = [Frame(k, k / 30, rng.integers(90, 110, (120, 160), dtype=np.uint8)) for k in range(24)]
    assert received(film, settings) == []


def test_unreadable_signal_is_refused() -> None:
    settings = load_settings("phone")
    with pytest.raises(SettingsError, match="the screen receiver reads"):
        heliograph.make_receiver(replace(settings.signal, modulation="ook"), settings.receive)
    with pytest.raises(SettingsError, match="has no effect"):
        load_settings("paper", None, ["receive.screen.gamma=2.0"])


@pytest.mark.slow
@pytest.mark.parametrize("side", [64, 96])
def test_many_cells_of_few_pixels_are_read(side: int) -> None:
    grabs = shown(sending_of(np.random.default_rng(side).bytes(9000), "a.bin", side, 30.0), 1.4, cell_px=8)
    phone = Phone(fps=60, width=9 * side, height=8 * side, side_px=7.0 * side, blur_px=0.7, shake_px=6, turn_deg=20)
    film = [Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(phone_frames(grabs, phone))]
    assert statuses(received(film, screen_settings(side, 30.0)))[0] == "ok"


def filmed(display_hz: float, lasts: int, skipped: float, seconds: float) -> list[Frame]:
    """Film a display at 30 frames/s; each pattern lasts `lasts` refreshes and a fraction of refreshes is skipped."""
    rng = np.random.default_rng(1)
    grabs = shown(sending_of(rng.bytes(3000), "a.bin", 16, display_hz / lasts), seconds, cell_px=8)
    refreshes = np.flatnonzero(rng.random(int(seconds * display_hz)) >= skipped)
    patterns, first = np.unique(refreshes // lasts, return_index=True)
    times_s = grabs.times_s[0] + refreshes[first] / display_hz
    phone = Phone(width=160, height=160, side_px=130, blur_px=0.6)
    seen = phone_frames(Grabs(times_s, grabs.pictures[patterns]), phone)
    return [Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(seen)]


@pytest.mark.slow
def test_rate_is_found_with_skipped_refreshes() -> None:
    film = filmed(display_hz=72, lasts=5, skipped=0.2, seconds=2.3 * 30 * 5 / 72)
    assert statuses(received(film, load_settings("phone")))[:2] == ["ok", "ok"]


@pytest.mark.slow
def test_rate_of_no_display_is_found() -> None:
    grabs = shown(sending_of(b"text", None, 16, 16.0), 4.2, cell_px=8)
    phone = Phone(fps=60, width=160, height=160, side_px=130, blur_px=0.6)
    film = [Frame(k, time_s, pixels) for k, (time_s, pixels) in enumerate(phone_frames(grabs, phone))]
    assert statuses(received(film, load_settings("phone")))[:2] == ["ok", "ok"]


@pytest.mark.slow
def test_folder_of_pictures_of_a_turned_phone_is_read(tmp_path: Path) -> None:
    settings, film = phone_60()
    for frame in film:
        picture = cv2.cvtColor(np.rot90(frame.pixels), cv2.COLOR_GRAY2BGR)
        assert cv2.imwrite(str(tmp_path / f"IMG_{frame.index:04d}.JPG"), picture)
    with heliograph.open_film(tmp_path, rate_hz=60) as pictures:
        packets = received(pictures, settings)
    assert [(packet.status, str(packet.orientation)) for packet in packets] == [("ok", "turned 270")]


def flickering(seconds: float) -> list[Frame]:
    rng, out = np.random.default_rng(1), list[Frame]()
    squares = [(rng.integers(5, 180), rng.integers(5, 60), rng.integers(40, 90), rng.uniform(1, 6)) for _ in range(3)]
    for k in range(int(seconds * 30)):
        light = np.full((160, 280), 60.0)
        for x, y, side, rate_hz in squares:
            x += round(3 * np.sin(k / 7))
            light[y : y + side, x : x + side] = 60 + 150 * (np.sin(2 * np.pi * rate_hz * k / 30) > 0)
        pixels = np.clip(light + rng.normal(0, 3, light.shape), 0, 255).astype(np.uint8)
        out.append(Frame(k, k / 30, pixels))
    return out


@pytest.mark.slow
def test_film_without_a_screen_costs_a_fraction_of_its_length(monkeypatch: pytest.MonkeyPatch) -> None:
    """A hand-held film with uniformly blinking squares in noise."""
    spent, recorder, seconds, limits, spend = list[float](), Recorder(), 5.4, SearchBudget(), SearchBudget.spend

    def counted(budget: SearchBudget, samples: float) -> None:
        spent.append(samples / SAMPLES_PER_S)
        spend(budget, samples)

    monkeypatch.setattr(SearchBudget, "spend", counted)
    assert received(flickering(seconds), load_settings("phone"), recorder) == []
    assert limits.first_s < sum(spent) < limits.first_s + limits.share * seconds + 2 * limits.debt_s
    assert [event.searched_s for event in recorder.of(UnseenEvent)] == pytest.approx([5.0], abs=0.1)
