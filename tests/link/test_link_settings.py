"""Settings tree and presets; `paper` equals the reference link."""

import math

import numpy as np
import pytest

from heliograph.base.errors import SettingsError
from heliograph.channel import frame_count
from heliograph.link.settings import PRESETS, LinkSettings, load_settings, preset
from heliograph.signal import pwm

PAPER = load_settings("paper")


def test_the_array_of_the_reference_link() -> None:
    emitter, signal = PAPER.channel.emitter, PAPER.signal
    assert signal.side == 16
    assert emitter.pitch_m == 0.020
    assert emitter.diameter_m == 0.005
    assert emitter.half_angle_deg == 22.6
    assert round(emitter.lobe_order, 1) == 8.7
    assert emitter.lobe_order == pytest.approx(-math.log(2) / math.log(math.cos(math.radians(22.6))))
    assert len(PAPER.channel.arrays) == len(PAPER.transmit.identities) == 1


def test_the_lighting_of_the_reference_link() -> None:
    signal = PAPER.signal
    assert signal.pattern_period_s == 1e-3
    assert pwm.SLOTS == 4
    assert pwm.SLOTS / signal.pattern_period_s == 4000
    shares = [pwm.lit_slots(np.full((1, 1), level, np.uint8), signal.slot_order).mean() for level in range(5)]
    assert shares == [0, 0.25, 0.5, 0.75, 1]
    assert list(pwm.invert(np.arange(5, dtype=np.uint8))) == [4, 3, 2, 1, 0]


def test_the_camera_and_lens_of_the_reference_link() -> None:
    camera = PAPER.channel.camera
    assert camera.fps == 1000
    assert camera.exposure_s <= PAPER.signal.pattern_period_s
    assert (camera.width, camera.height) == (1024, 512)
    assert camera.pixel_m == 12e-6
    assert PAPER.channel.sensor.bits == 8
    assert camera.focal_m == 0.035
    assert round(camera.focal_px) == 2917
    assert camera.blur_px == 0.5
    assert camera.clock_ppm == 0


def test_the_pitch_in_the_image_of_the_reference_link() -> None:
    scale = PAPER.channel.camera.focal_px * PAPER.channel.emitter.pitch_m
    assert round(scale, 1) == 58.3
    pitches = {25: 2.33, 50: 1.17, 80: 0.73, 150: 0.39}
    assert {z: round(scale / z, 2) for z in pitches} == pitches


def test_the_sensor_of_the_reference_link() -> None:
    sensor = PAPER.channel.sensor
    assert sensor.full_well_e == 15_000
    assert sensor.dark_noise_e == 40
    assert PAPER.channel.emitter.all_on == 0.8
    # sigma_y^2 = K^2 (sigma_d^2 + mu_e) + 1/12 DN^2, about 0.6 % of full scale at mid level
    k = 255 / 15_000
    assert math.sqrt(k**2 * (40**2 + 7500) + 1 / 12) / 255 == pytest.approx(0.006, abs=0.001)
    assert sensor.gain_dn_per_e == k


def test_the_drive_of_the_reference_link() -> None:
    channel = PAPER.channel
    assert (channel.distance_m, channel.stop_m) == (80, 25)
    assert channel.speed_m_s == pytest.approx(8.33, abs=0.005)
    assert channel.speed_m_s * 3.6 == pytest.approx(30)
    assert channel.shake == "road"
    assert channel.road_class in ("A", "B", "C", "D")
    assert frame_count(channel) == 6600  # 55 m at 30 km/h


def test_the_receiver_knows_the_same_camera() -> None:
    known, camera = PAPER.receive.calibration, PAPER.channel.camera
    assert (known.focal_m, known.pixel_m) == (camera.focal_m, camera.pixel_m)
    assert known.pitch_m == PAPER.channel.emitter.pitch_m
    assert PAPER.receive.receiver == "plain"
    assert PAPER.receive.decode.iterations == 8


def test_paper_is_the_default() -> None:
    assert load_settings() == PAPER == LinkSettings()


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_loads_and_is_described(name: str) -> None:
    assert isinstance(load_settings(name), LinkSettings)
    assert PRESETS[name][0]


def test_two_arrays_have_two_identities() -> None:
    settings = load_settings("two-arrays")
    assert len(settings.channel.arrays) == 2
    assert len(set(settings.transmit.identities)) == 2


def test_an_unknown_preset_names_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r"unknown preset 'papr'; did you mean 'paper'\?"):
        preset("papr")
    with pytest.raises(SettingsError, match="there are paper, static"):
        preset("qqqqq")


def test_a_preset_handed_out_may_be_changed_without_harm() -> None:
    preset("static")["channel"] = {}
    assert load_settings("static").channel.distance_m == 50


@pytest.mark.parametrize("identities", ["[]", "[1, 2]"])
def test_identities_and_arrays_must_match(identities: str) -> None:
    with pytest.raises(SettingsError, match="an identity for each array"):
        load_settings(assignments=[f"transmit.identities={identities}"])


def test_identities_must_differ() -> None:
    with pytest.raises(SettingsError, match="must differ"):
        load_settings("two-arrays", assignments=["transmit.identities=[3, 3]"])


def test_own_settings_that_no_part_reads_are_refused() -> None:
    with pytest.raises(SettingsError, match=r"channel\.custom\.wind_rad has no effect"):
        load_settings("static", None, ["channel.custom.wind_rad=3e-4"])
