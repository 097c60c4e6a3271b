"""Settings tree and presets; `paper` equals the reference link."""

import math
from operator import attrgetter

import pytest

from heliograph.base.errors import SettingsError
from heliograph.channel.camera import frame_count
from heliograph.link.settings import PRESETS, LinkSettings, load_settings, preset

PAPER = load_settings("paper")
REFERENCE = {
    "signal.side": 16, "signal.pattern_period_s": 1e-3,
    "channel.emitter.pitch_m": 0.020, "channel.emitter.diameter_m": 0.005, "channel.emitter.half_angle_deg": 22.6,
    "channel.emitter.all_on": 0.8,
    "channel.camera.fps": 1000, "channel.camera.exposure_s": 1e-3, "channel.camera.width": 1024,
    "channel.camera.height": 512, "channel.camera.pixel_m": 12e-6, "channel.camera.focal_m": 0.035,
    "channel.camera.blur_px": 0.5, "channel.camera.clock_ppm": 0,
    "channel.sensor.bits": 8, "channel.sensor.full_well_e": 15_000, "channel.sensor.dark_noise_e": 40,
    "channel.distance_m": 80, "channel.stop_m": 25, "channel.shake": "road", "channel.road_class": "B",
    "transmit.identities": (0,),
    # the receiver knows the same camera and array
    "receive.calibration.focal_m": 0.035, "receive.calibration.pixel_m": 12e-6, "receive.calibration.pitch_m": 0.020,
    "receive.receiver": "plain", "receive.decode.iterations": 8,
}  # fmt: skip


def test_paper_is_the_reference_link_and_the_default() -> None:
    assert {key: attrgetter(key)(PAPER) for key in REFERENCE} == REFERENCE
    emitter, camera, sensor, channel = PAPER.channel.emitter, PAPER.channel.camera, PAPER.channel.sensor, PAPER.channel
    assert emitter.lobe_order == pytest.approx(-math.log(2) / math.log(math.cos(math.radians(22.6))))
    assert (round(emitter.lobe_order, 1), len(channel.arrays), round(camera.focal_px)) == (8.7, 1, 2917)
    assert {z: round(camera.focal_px * emitter.pitch_m / z, 2) for z in (25, 50, 80, 150)} == {
        25: 2.33, 50: 1.17, 80: 0.73, 150: 0.39
    }  # fmt: skip
    k = sensor.gain_dn_per_e  # sigma_y^2 = K^2 (sigma_d^2 + mu_e) + 1/12 DN^2, about 0.6 % of full scale at mid level
    assert k == 255 / 15_000
    assert math.sqrt(k**2 * (40**2 + 7500) + 1 / 12) / 255 == pytest.approx(0.006, abs=0.001)
    assert channel.speed_m_s * 3.6 == pytest.approx(30)
    assert frame_count(channel) == 6600  # 55 m at 30 km/h
    assert load_settings() == PAPER == LinkSettings()


def test_an_unknown_preset_names_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r"unknown preset 'papr'; did you mean 'paper'\?"):
        preset("papr")
    with pytest.raises(SettingsError, match="there are paper, static"):
        preset("qqqqq")


def test_presets_are_described_and_may_be_changed_without_harm() -> None:
    assert all(about for about, *_ in PRESETS.values())
    preset("static")["channel"] = {}
    assert load_settings("static").channel.distance_m == 50


@pytest.mark.parametrize(("preset_name", "change", "message"), [
    ("paper", "transmit.identities=[]", "an identity for each array"),
    ("paper", "transmit.identities=[1, 2]", "an identity for each array"),
    ("two-arrays", "transmit.identities=[3, 3]", "must differ"),
    ("static", "channel.custom.wind_rad=3e-4", r"channel\.custom\.wind_rad has no effect"),
])  # fmt: skip
def test_inconsistent_settings_are_refused(preset_name: str, change: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        load_settings(preset_name, assignments=[change])
