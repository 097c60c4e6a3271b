"""Link budget: consistent numbers and warnings; photometry against textbook values."""

import math
from dataclasses import replace
from typing import Any

import pytest

import heliograph
from heliograph.base.errors import SettingsError
from heliograph.channel.settings import CameraSettings, ChannelSettings
from heliograph.link.budget import budgets, detection_range_m
from heliograph.link.photometry import LightSettings
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive.api import make_receiver
from heliograph.receive.events import DetectEvent, Event
from heliograph.signal.packet import PacketFormat

SMALL: dict[str, Any] = {"signal": {"side": 4, "data_pairs": 192}}


def small(**channel: Any) -> LinkSettings:
    return load_settings("static", {**SMALL, "channel": channel})


@pytest.fixture(scope="module")
def reference() -> heliograph.Budget:
    return heliograph.budget(small(distance_m=50.0))


@pytest.mark.slow
def test_array_appears_as_in_the_reference_link(reference: heliograph.Budget) -> None:
    """1.17 px per LED at 50 m, 80 % of a 15,000-electron full well, 0.6 % noise."""
    spot = reference.spot
    assert spot.pitch_px == pytest.approx(1.167, abs=1e-3)
    assert spot.side_px == pytest.approx(4 * spot.pitch_px)
    assert spot.electrons_px == pytest.approx(12000, rel=0.01)
    assert spot.electrons_led == pytest.approx(spot.electrons_px * spot.pitch_px**2)
    assert spot.light == pytest.approx(0.8, rel=0.01)
    assert spot.noise == pytest.approx(0.006, rel=0.02)
    assert reference.notes == ()
    assert spot.blur_pitches == pytest.approx(spot.blur_px / spot.pitch_px)


@pytest.mark.slow
@pytest.mark.parametrize(("fps", "yaw_deg"), [(1000, 0), (1000, 25), (1700, 0)])
def test_photoelectrons_per_bit_agree_with_a_film(fps: int, yaw_deg: float) -> None:
    """The light of a packet, in the gray levels of a film without the light of the panel."""
    changes = {
        "sensor": {"dark_noise_e": 0},
        "background": {"kind": "flat"},
        "camera": {"fps": fps, "exposure_s": 1 / fps, "width": 96, "height": 96},
        "arrays": [{"x_m": 0.01, "y_m": 0.0, "yaw_deg": yaw_deg}],
    }
    lit, dark = (
        small(distance_m=60.0, duration_s=0.5, emitter=emitter, **changes) for emitter in ({}, {"all_on": 1e-6})
    )
    gray = [
        sum(float(frame.pixels.sum(dtype="float64")) for frame, _ in simulate(link, default_messages(link), 7))
        for link in (lit, dark)
    ]
    sensor, signal = lit.channel.sensor, lit.signal
    electrons = (gray[0] - gray[1]) * sensor.full_well_e / sensor.full_scale
    layers = PacketFormat(signal).layers.values()
    bits = sum(layer.codewords * layer.code.k for layer in layers) * 0.5 / signal.packet_s
    assert electrons / bits == pytest.approx(heliograph.budget(lit).spot.electrons_bit, rel=0.01)


@pytest.mark.slow
def test_fog_dims_the_array_and_leaves_less_information(reference: heliograph.Budget) -> None:
    fog = heliograph.budget(small(distance_m=50.0, weather={"visibility_m": 100.0, "airlight": 0.4}))
    assert fog.spot.light == pytest.approx(reference.spot.light * 0.05**0.5, rel=1e-3)
    panel = 0.02 * 0.05**0.5 + 0.4 * (1 - 0.05**0.5)
    variance = 40**2 + 15000 * (fog.spot.light / 2 + panel)
    assert fog.spot.noise == pytest.approx(math.sqrt(variance / 15000**2 + 1 / 12 / 255**2), rel=1e-3)
    for dim, clear in zip(fog.layers, reference.layers, strict=True):
        assert dim.range_m <= clear.range_m
        assert dim.here <= clear.here
    assert sum(one.here for one in fog.layers) < sum(one.here for one in reference.layers) - 0.03


@pytest.mark.slow
def test_layers_end_in_the_order_of_their_priority(reference: heliograph.Budget) -> None:
    by = {(one.receiver, str(one.mode), one.layer): one for one in reference.layers}
    assert len(by) == 9
    for receiver, mode in (("plain", "paired"), ("soft", "paired"), ("soft", "single")):
        far = [by[receiver, mode, layer].range_m for layer in ("high", "middle", "low")]
        assert far == sorted(far, reverse=True)
    for one in by.values():
        assert one.range_m <= one.most_m * 1.001 <= reference.found_m[one.receiver] * 1.002
        assert one.here >= one.needed
        assert one.range_m >= min(50, reference.found_m[one.receiver])
    assert by["soft", "paired", "low"].range_m > by["plain", "paired", "low"].range_m
    assert by["soft", "paired", "low"].range_m >= by["soft", "single", "low"].range_m


@pytest.mark.slow
def test_formats_that_are_sent_are_those_that_count() -> None:
    form = [{"mode": "single", "low": 0.9}]
    found = heliograph.budget(load_settings("static", {**SMALL, "transmit": {"formats": form}}))
    assert {(one.receiver, one.mode) for one in found.layers} == {("soft", "single")}
    assert [one.rate for one in found.layers] == [1 / 3, 1 / 3, 0.9]


@pytest.mark.slow
def test_distances_of_one_link_have_one_range() -> None:
    near, far = (one.layers for one in budgets([small(distance_m=30.0), small(distance_m=90.0)], LightSettings()))
    assert [(one.range_m, one.most_m) for one in near] == [(one.range_m, one.most_m) for one in far]
    assert all(a.here >= b.here for a, b in zip(near, far, strict=True))


@pytest.mark.parametrize(("light", "channel", "message"), [
    ({"candela": 20.0}, {}, "the array saturates, 18 full scales with every LED on: close the lens to f/52"),
    ({"candela": 0.01}, {}, "too dim to be detected, 0.009 of full scale"),
    ({}, {"camera": {"fps": 500.0}}, "500 frames/s are fewer than the 1000 patterns a second"),
    ({}, {"camera": {"exposure_s": 4e-4}}, "an exposure of 0.4 ms covers a part of each pattern of 1 ms"),
    ({"f_number": 32.0}, {}, "a lens of f/32 blurs by 0.7 px at 50 m, more than channel.camera.blur_px=0.5"),
    ({}, {"distance_m": 5.0}, "at 5 m the array is not in the picture: +875, -583 px from the centre"),
])  # fmt: skip
@pytest.mark.slow
def test_obstacles_of_a_budget_are_reported(light: dict[str, Any], channel: dict[str, Any], message: str) -> None:
    found = heliograph.budget(small(**channel), heliograph.LightSettings(**light))
    assert any(message in note for note in found.notes), found.notes
    assert bool(found.layers) == ("saturates" not in message)


@pytest.mark.parametrize(("arguments", "message"), [
    ((None,), "a budget is of heliograph.load_settings(...), not NoneType"),
    ((load_settings(), 3), "light is a heliograph.LightSettings, not 3"),
    ((small(distance_m=3.0, arrays=({"z_offset_m": -4.0, "vz_m_s": 9.0},)),), "1 m behind the camera"),
])  # fmt: skip
def test_invalid_link_is_reported_in_one_line(arguments: Any, message: str) -> None:
    with pytest.raises(SettingsError) as caught:
        heliograph.budget(*arguments)
    assert message in str(caught.value)


@pytest.mark.parametrize(("receiver", "share", "is_found"), [
    ("plain", 0.98, True), ("plain", 1.04, False), ("soft", 0.98, True), ("soft", 1.04, False),
])  # fmt: skip
def test_an_array_is_found_up_to_the_stated_distance(receiver: str, share: float, is_found: bool) -> None:
    small_camera = {"camera": {"width": 64, "height": 64}, "arrays": [{"x_m": 0.0, "y_m": 0.0}], "duration_s": 0.03}
    link = load_settings("static", {"channel": small_camera, "receive": {"receiver": receiver}})
    distance_m = share * detection_range_m(link, receiver)
    link, events = replace(link, channel=replace(link.channel, distance_m=distance_m)), list[Event]()
    receive = make_receiver(link.signal, link.receive, events.append)
    for frame, _ in simulate(link, default_messages(link), 1):
        list(receive.push(frame))
    list(receive.finish())
    assert any(isinstance(event, DetectEvent) for event in events) == is_found


@pytest.mark.parametrize(("wavelength_nm", "photons"), [(555, 4.09e15), (625, 1.435e16), (500, 1.141e16)])
def test_photons_of_a_lumen(wavelength_nm: float, photons: float) -> None:
    """683 V(lambda) lm/W and h c / lambda, with CIE V = 1.000, 0.321 and 0.323."""
    light = LightSettings(wavelength_nm=wavelength_nm)
    assert light.photons_per_lumen_second == pytest.approx(photons, rel=0.012)


@pytest.mark.parametrize("distance_m", [20.0, 150.0])
@pytest.mark.parametrize("focal_m", [0.016, 0.05])
def test_electrons_are_those_of_the_solid_angle(distance_m: float, focal_m: float) -> None:
    channel = ChannelSettings(camera=CameraSettings(focal_m=focal_m, exposure_s=4e-4))
    light = LightSettings(f_number=4.0, efficiency=0.5)
    opening_m2 = math.pi * (focal_m / 4.0) ** 2 / 4
    lumens = 2.0 * opening_m2 / distance_m**2
    of_led = 0.5 * lumens * 4e-4 * light.photons_per_lumen_second
    pitch_px = focal_m * channel.emitter.pitch_m / distance_m / channel.camera.pixel_m
    assert light.electrons(channel, 2.0) == pytest.approx(of_led / pitch_px**2)


def test_intensity_and_light_are_inverse() -> None:
    channel = ChannelSettings()
    meant = LightSettings().candela_of(channel)
    assert 0.5 < meant < 2
    assert LightSettings(candela=meant).all_on(channel) == pytest.approx(channel.emitter.all_on)
    assert LightSettings(candela=3.0).candela_of(channel) == 3.0


def test_the_lens_blurs_by_diffraction_and_focus() -> None:
    channel = ChannelSettings()
    wide, narrow = (LightSettings(f_number=number).lens_blur_px(channel, 1e4) for number in (2.0, 22.0))
    assert narrow == pytest.approx(11 * wide, rel=1e-3)
    # the first dark ring of the Airy disc, at 1.22 lambda N, is 2.9 standard deviations out
    assert narrow * channel.camera.pixel_m == pytest.approx(1.22 * 625e-9 * 22 / 2.9, rel=0.01)
    near = LightSettings(f_number=2.0).lens_blur_px(channel, 5.0) * channel.camera.pixel_m
    assert near == pytest.approx(0.035**2 / (2 * 5) / 4, rel=1e-3)
