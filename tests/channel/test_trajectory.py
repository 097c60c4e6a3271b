"""Trajectories of camera and arrays: files, truth against the curves, rendered light, and reception."""

import tomllib
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.base.toml_text import to_toml
from heliograph.benchmarks.benchmark import plan_benchmark
from heliograph.channel.camera import film
from heliograph.channel.motion import Travel, film_duration, nearest_m
from heliograph.channel.settings import ChannelSettings
from heliograph.channel.truth import ArrayTruth
from heliograph.link.settings import load_settings
from heliograph.link.tables import load_trajectory
from heliograph.measure.bench import is_static, lasting, run_block
from heliograph.sweeps.plan import plan

Curve = Callable[[Floats], Floats]  # times -> (5, times): time, x, y, z, yaw in degrees

STILL = {"shake": "none", "camera": {"fps": 50.0}, "duration_s": 1.0}


def chaser(t: Floats) -> Floats:
    """Drive a bend to the left from (4e5, 5.2e6) on, heading 150 degrees, through 180 degrees."""
    turn = np.radians(150) + 0.6 * t
    x, y = 4e5 + 15 / 0.6 * (np.sin(turn) - np.sin(turn[0])), 5.2e6 - 15 / 0.6 * (np.cos(turn) - np.cos(turn[0]))
    return np.array([t, x, y, 30 + 0.5 * np.sin(2 * t), (np.degrees(turn) + 180) % 360 - 180])


def leader(t: Floats) -> Floats:
    _, x, y, z, yaw = chaser(t)
    ahead, left = 28 + 3 * np.sin(2.2 * t), 1.5 * np.cos(1.8 * t)
    c, s = np.cos(np.radians(yaw)), np.sin(np.radians(yaw))
    return np.array([t, x + c * ahead - s * left, y + s * ahead + c * left, z + 0.3, yaw + 12 * np.sin(t)])


def written(path: Path, curve: Curve, columns: str = "time_s,x_m,y_m,z_m,yaw_deg") -> str:
    rows = curve(np.linspace(0, 1.2, 13)).T[:, : columns.count(",") + 1]
    np.savetxt(path, rows, "%.6f", ",", header=columns, comments="")
    return str(path)


def truths(channel: ChannelSettings, seed: int = 5) -> list[tuple[float, tuple[ArrayTruth, ...]]]:
    """Return mid-exposures and truths of a film of lit arrays."""
    lit = [np.full((8, 8), 4, np.uint8)] * 2000
    shots = film(
        channel, [lit] * len(channel.arrays), np.random.default_rng(seed), pattern_period_s=1e-3, roi_margin_px=2
    )
    return [(truth.time_s + channel.camera.exposure_s / 2, truth.arrays) for _, truth in shots]


def position(truth: ArrayTruth, channel: ChannelSettings) -> Floats:
    """Return the array centre in the axes of the camera: right, down, forward."""
    camera, (x, y, z) = channel.camera, truth.homography[:, 2]
    return np.array(
        [(x - (camera.width - 1) / 2 * z) / camera.focal_px, (y - (camera.height - 1) / 2 * z) / camera.focal_px, z]
    )


def test_truth_follows_the_files_of_camera_and_array(tmp_path: Path) -> None:
    files = written(tmp_path / "chaser.csv", chaser), written(tmp_path / "leader.csv", leader)
    mounted = {"x_m": 0.6, "y_m": 0.2, "z_offset_m": -1.1, "trajectory": files[1]}
    over = {"channel": {**STILL, "trajectory": files[0], "arrays": [mounted]}}
    channel = load_settings("paper", over).channel
    found = truths(channel)
    assert len(found) == 50
    for time_s, (truth,) in found:
        (_, *eye, facing), (_, *origin, heading) = (curve(np.array([0, time_s]))[:, 1] for curve in (chaser, leader))
        # ISO 8855: forward, left, up
        centre = origin + Rotation.from_euler("z", heading, degrees=True).apply([-1.1, -0.6, -0.2])
        forward, left, up = Rotation.from_euler("z", facing, degrees=True).inv().apply(centre - np.array(eye))
        assert position(truth, channel) == pytest.approx([-left, -up, forward], abs=0.01)
        assert truth.distance_m == pytest.approx(forward, abs=0.01)
        across = np.linalg.inv(
            np.array([[channel.camera.focal_px, 0, 511.5], [0, channel.camera.focal_px, 255.5], [0, 0, 1]])
        )
        right = across @ truth.homography[:, 0]
        turned = np.radians(heading - facing)
        assert right == pytest.approx([np.cos(turned), 0, np.sin(turned)], abs=1e-3)


def test_vehicle_that_turns_right_shows_its_right_side_nearer() -> None:
    path = [[0, 20, 0, 0, 0], [1.1, 20, 0, 0, -33]]
    channel = load_settings("paper", {"channel": {**STILL, "speed_m_s": 0, "arrays": [{"trajectory": path}]}}).channel
    first, *_, last = (truth for _, (truth,) in truths(channel))
    assert first.homography[2, 0] > -0.01
    assert last.homography[2, 0] == pytest.approx(-np.sin(np.radians(30)), abs=0.02)


def test_camera_that_turns_left_sees_a_standing_array_move_right() -> None:
    path = [[0, 7, 7, 0, 90], [1.1, 7, 7, 0, 95.5]]
    channel = load_settings("paper", {"channel": {**STILL, "trajectory": path, "arrays": [{"x_m": 0}]}}).channel
    found = [truth for _, (truth,) in truths(channel)]
    assert found[0].x == pytest.approx(511.5, abs=1)
    assert found[-1].x - 511.5 == pytest.approx(channel.camera.focal_px * np.tan(np.radians(4.9)), abs=3)


def test_trajectory_at_constant_speed_equals_the_speed_with_shake() -> None:
    scene = {**STILL, "shake": "road", "road_class": "C", "arrays": [{}, {"x_m": -2, "z_offset_m": 5}]}
    by_speed = load_settings("two-arrays", {"channel": {**scene, "speed_m_s": 12}}).channel
    path = [[t, 12 * t, 0, 0, 0] for t in (-1, 0.2, 3)]
    by_path = load_settings("two-arrays", {"channel": {**scene, "trajectory": path}}).channel
    homographies = [np.array([[a.homography for a in both] for _, both in truths(c)]) for c in (by_speed, by_path)]
    assert homographies[0] == pytest.approx(homographies[1], rel=1e-9, abs=1e-6)
    still = truths(load_settings("two-arrays", {"channel": {**scene, "trajectory": path, "shake": "none"}}).channel)
    assert np.ptp([a[0].y - b[0].y for (_, a), (_, b) in zip(truths(by_path), still, strict=True)]) > 1
    assert Travel.of(by_path).speed_m_s == pytest.approx([12, 12, 12])


def test_light_lies_where_the_truth_says(tmp_path: Path) -> None:
    dark = {"sensor": {"dark_noise_e": 0.0}, "background": {"level": 0.0}, "emitter": {"panel_level": 0.0}}
    # 25 m/s to the right, which an exposure blurs by 2.4 px; the other array stands
    path = [[t, 30, 2 - 25 * t, 0, 20] for t in (0, 0.1, 0.15)]
    arrays = [{"x_m": 0, "y_m": 0.3, "trajectory": path}, {"x_m": -3, "z_offset_m": -40}]
    scene = {**STILL, "speed_m_s": 10, "duration_s": 0.1, "arrays": arrays, "camera": {"fps": 100.0}, **dark}
    channel = load_settings("two-arrays", {"channel": scene}).channel
    lit = [np.full((8, 8), 4, np.uint8)] * 100
    shots = list(film(channel, [lit, lit], np.random.default_rng(3), pattern_period_s=1e-3))
    assert len(shots) == 10
    for frame, truth in shots:
        for array in truth.arrays:
            x, y = round(array.x), round(array.y)
            part = frame.pixels[y - 24 : y + 25, x - 24 : x + 25].astype(float)
            rows, columns = np.indices(part.shape)
            assert np.average(columns, weights=part) + x - 24 == pytest.approx(array.x, abs=0.15)
            assert np.average(rows, weights=part) + y - 24 == pytest.approx(array.y, abs=0.15)
    widths = [np.flatnonzero(frame.pixels[round(t.arrays[0].y)] > 8).size for frame, t in shots]
    assert max(widths) < 40, "8 LEDs at 2 px and 2.4 px of motion"


def test_files_become_part_of_the_settings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text("yaw_deg,y_m,note,x_m,time_s\n3,1,a,20,0\n4,2,b,21,2\n", encoding="utf-8-sig")
    settings = load_settings("two-arrays", None, ["channel.arrays.1.trajectory=a.csv", "channel.speed_m_s=0"])
    assert settings.channel.arrays[1].trajectory == ((0, 20, 1, 0, 3), (2, 21, 2, 0, 4))
    assert not settings.channel.arrays[0].trajectory
    assert load_settings("paper", tomllib.loads(to_toml(asdict(settings)))) == settings
    assert (film_duration(settings.channel), is_static(settings)) == (2, False)
    assert nearest_m(settings.channel) == pytest.approx(20)
    (tmp_path / "b.csv").write_text("time_s,x_m,y_m\n0,20,1\n2,21,2.5\n")
    points = plan({"channel.arrays.0.trajectory": ["a.csv", "b.csv"]}, "static", {"channel": {"duration_s": 1.0}})
    (tmp_path / "a.csv").unlink()
    assert [p.job(0)["settings"]["channel"]["arrays"][0]["trajectory"][1][2] for p in points] == [2, 2.5]
    assert points[0].text == "channel.arrays.0.trajectory=a.csv"


@pytest.mark.parametrize(("text", "said"), [
    (None, "cannot read the trajectory file lead.csv: No such file"), ("", "is empty; a trajectory file has time_s"),
    ("time_s,x_m\n0,1\n1,2\n", "lacks the column 'y_m'; a trajectory file has time_s, x_m, y_m"),
    ("time_s,x_m,y_m\n", "has 0 points; a trajectory has at least 2"), ("time_s,x_m,y_m\n0,1,2\n", "has 1 points"),
    ("time_s,x_m,y_m\n0,1,2\n1,,2\n2,1,2\n", "row 2 below the header lacks a number"),
    ("time_s,x_m,y_m,yaw_deg\n0,1,2,nan\n1,1,2,3\n", "row 1 below the header lacks a number"),
    ("time_s,x_m,y_m\n0,1,2\n1,1\n", "Line #3"), ("time_s,x_m,y_m\n0,1,2\n2,1,2\n1.5,1,2\n", "rise, unlike 1.5 s"),
    ("time_s,x_m,y_m\n0,1,2\n0.5,1,2\n", r"lasts from 0 s to 0.5 s, the film from 0 s to 1 s; extend it"),
    ("time_s,x_m,y_m\n0.1,1,2\n3,1,2\n", r"channel.arrays.0.trajectory lasts from 0.1 s to 3 s"),
])  # fmt: skip
def test_wrong_file_is_reported_on_a_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str | None, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    if text is not None:
        (tmp_path / "lead.csv").write_text(text)
    with pytest.raises(SettingsError, match=said) as caught:
        load_settings("static", None, ["channel.arrays.0.trajectory=lead.csv"])
    assert "channel.arrays.0.trajectory" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_trajectory_has_a_limited_number_of_points_and_excludes_velocities() -> None:
    path = [[k * 0.1, 20 + k, 0, 0, 0] for k in range(36_001)]
    assert load_settings("static", {"channel": {"trajectory": path[:-1]}}).channel.moves
    with pytest.raises(SettingsError, match="2 to 36000 points, not 36001; read fewer points per second"):
        load_settings("static", {"channel": {"trajectory": path}})
    moving = {"trajectory": [[0, 20, 0, 0, 0], [2, 20, 0, 0, 0]], "vx_m_s": 1.0}
    with pytest.raises(SettingsError, match="has a trajectory or velocities: set vx_m_s, vy_m_s and vz_m_s to 0"):
        load_settings("static", {"channel": {"arrays": [moving]}})


def test_shipped_trajectories_are_the_stated_curves() -> None:
    change, platoon = (
        tally.point.settings.channel for tally in plan_benchmark(["lane-change", "platoon"], ["soft"], 0, 1)
    )
    t, _, y, _, yaw = np.array(change.arrays[0].trajectory).T
    s = np.clip(t / 3, 0, 1)
    assert y == pytest.approx(3.5 - 3.5 * (10 * s**3 - 15 * s**4 + 6 * s**5), abs=1e-4)
    assert np.tan(np.radians(yaw)) * 32.78 == pytest.approx(np.gradient(y, t), abs=0.1)
    gap = np.subtract(platoon.arrays[0].trajectory, platoon.trajectory)
    assert gap[:, 1] == pytest.approx(17 + 6 * np.cos(2 * np.pi * np.array(platoon.trajectory)[:, 0] / 8), abs=2e-4)
    assert nearest_m(platoon) == pytest.approx(11, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_lane_change_is_received(receiver: str) -> None:
    """The vehicle moves by 2.2 m/s to the side; three packets."""
    (tally,) = plan_benchmark(["lane-change"], [receiver], 0, 1)
    settings = lasting(tally.point.settings, 1.71)
    over = {"channel": {**asdict(settings)["channel"], "camera": {"start_s": 1.4}}}
    counts = run_block(load_settings("motorway", {**over, "receive": {"receiver": receiver}}), 11)
    assert (counts.packets, counts.detected) == (3, 3)
    assert [counts.layers[name].codeword_errors for name in ("high", "middle", "low")] == [0, 0, 0]
    assert counts.layers["low"].codewords == 3


def test_points_of_a_file_are_read_by_name(tmp_path: Path) -> None:
    assert len(load_trajectory(Path(written(tmp_path / "a.csv", leader, "time_s,x_m,y_m")))) == 13
