"""Trackers on small films, and verdicts from given scores."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from heliograph.base.frames import Frame
from heliograph.experiments import tracking
from heliograph.experiments.report import Finding
from heliograph.experiments.trackers import GROWTH, KNOWN_SPREAD, KnownPattern, known_leds, known_light
from heliograph.experiments.tracking import KNOWN, OURS, TRACKERS, TrackingRun, TrackingScore, score
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import Pose

pytestmark = pytest.mark.slow
DAY, DARK = "day", "dark"


def settings(background: dict[str, Any]) -> LinkSettings:
    """Place an array near the centre of a small camera image, on a bad road."""
    channel = {
        "distance_m": 50.0, "duration_s": 0.11, "road_class": "C", "camera": {"width": 256, "height": 192},
        "arrays": [{"x_m": 0.2, "y_m": -0.2}], "background": background, "emitter": {"panel_level": 0.0},
    }  # fmt: skip
    return load_settings("paper", {"channel": channel})


def run_of(name: str, background: dict[str, Any]) -> TrackingRun:
    return tracking.run_trackers({}, None, 3, (name, settings(background)))


@pytest.fixture(scope="module")
def day() -> TrackingRun:
    return run_of(DAY, {"kind": "synthetic", "gain": 0.3})


@pytest.fixture(scope="module")
def dark() -> TrackingRun:
    return run_of(DARK, {"kind": "flat", "level": 0.0})


def test_all_trackers_process_the_same_pairs_and_fill_tables_and_pictures(day: TrackingRun, dark: TrackingRun) -> None:
    assert list(day.errors) == list(TRACKERS)
    # 55 pairs minus the two header pairs that initialise the trackers
    assert ({len(errors) for errors in day.errors.values()}, len(day.cuts)) == ({53}, 8)
    table = tracking.scores([day, dark])
    for one in tracking.tables(table):
        assert {len(row) for row in one.rows} == {len(one.head)}
    assert len(tracking._pictures([day, dark])) == 3


def test_trackers_of_the_array_need_no_background(day: TrackingRun, dark: TrackingRun) -> None:
    for run in (day, dark):
        for found in (score(run, run.errors[name]) for name in (OURS, KNOWN)):
            assert found.rms_px < 0.1
            assert found.lost == 0
            assert found.pitch is not None
            assert found.pitch < 0.03


def test_the_background_shows_the_vibration_by_day_but_not_the_approach(day: TrackingRun, dark: TrackingRun) -> None:
    by_day, still, ours = (score(day, day.errors[name]) for name in (tracking.BACKGROUND, "none", OURS))
    assert still.rms_px > 1.0
    assert still.pitch is None
    assert still.shake_px > max(10 * ours.shake_px, by_day.shake_px / 0.3)
    assert by_day.rms_px > 3 * ours.rms_px
    assert score(dark, dark.errors[tracking.BACKGROUND]).shake_px > 0.5 * score(dark, dark.errors["none"]).shake_px


def test_general_trackers_stay_near(dark: TrackingRun) -> None:
    assert [score(dark, dark.errors[name]).lost for name in ("OpenCV MIL", "OpenCV template")] == [0, 0]


def test_known_light_keeps_its_leds_lit_and_is_not_inverted() -> None:
    light = known_light(settings({"kind": "flat"}), 0, 1)
    patterns = np.stack([next(light) for _ in range(60)])
    known = known_leds(16)
    assert known.sum() == 64
    assert (patterns[0] + patterns[1] == 4).all()  # header pattern and inverse
    assert (patterns[4:, known] == 4).all()
    assert not (patterns[4:-1:2] + patterns[5::2] == 4).all((1, 2)).any()
    assert patterns[4:, ~known].std() / 4 == pytest.approx(KNOWN_SPREAD, rel=0.05)  # the data spread assumed by the fit


def test_a_lost_known_pattern_stays_in_the_frame_with_a_plausible_size() -> None:
    link, rng = settings({"kind": "synthetic"}), np.random.default_rng(0)
    pose = Pose(128.0, 96.0, 1.2, 0.0, 0.8)
    fit = Fit(pose.vector(), np.diag([0.01, 0.01, 1e-4, 1e-4, 1e-2]), 150.0, 0.99)
    frames = [Frame(k, 1e-3 * k, rng.integers(0, 255, (192, 256), dtype=np.uint8), 8) for k in range(200)]
    detection = Detection(0, 0.0, fit, 0.0015, 0.99, 1.0, np.ones((16, 16)))
    tracker = KnownPattern(link, detection, *frames[2:4])
    found = [tracker.update(one, other) for one, other in zip(frames[4::2], frames[5::2], strict=True)]
    assert all(GROWTH[0] <= p.pitch / pose.pitch <= GROWTH[1] for p in found)
    assert all(0 <= p.x < 256 and 0 <= p.y < 192 for p in found)
    assert found[-1] == found[-2]  # a lost tracker stops


def test_scores_of_known_errors() -> None:
    n = 200
    errors = np.column_stack([np.full(n, 0.3), np.full(n, 0.4), np.full(n, np.nan)])
    errors[0, :2] = 20.0, 0.0
    times = np.linspace(0, 2e-3 * (n - 1), n)
    run = TrackingRun("film", times, np.full(n, 18.0), (times / 0.1 + 1e-6).astype(np.int64), {})
    found = score(run, errors)
    assert (found.pairs, found.near, found.lost, found.pitch) == (n, 0, 1, None)
    assert found.rms_px == pytest.approx(np.sqrt((199 * 0.25 + 400) / 200))
    steady = np.column_stack([0.3 + 5 * times, 1 - 3 * times, np.zeros(n)])
    assert score(run, steady).pitch == 0
    assert score(run, steady).shake_px == pytest.approx(0, abs=1e-9)


GOOD = TrackingScore(pairs=100, rms_px=0.01, q999_px=0.03, near=100, lost=0, shake_px=0.01, pitch=0.001)
AWAY = TrackingScore(pairs=100, rms_px=9.0, q999_px=20.0, near=0, lost=60, shake_px=0.4, pitch=None)


def fake(**changes: TrackingScore) -> dict[str, dict[str, TrackingScore]]:
    """Return a table that meets all tracking claims; changes are named film_tracker."""
    row = dict.fromkeys(TRACKERS, GOOD) | {"none": AWAY}
    table = {DAY: dict(row), DARK: row | {tracking.BACKGROUND: AWAY}}
    for key, value in changes.items():
        film, name = key.split("_")
        table[film][{"ours": OURS, "back": tracking.BACKGROUND}.get(name, name)] = value
    return table


def finding(table: dict[str, dict[str, TrackingScore]], start: str, *clips: str, full: bool = True) -> Finding:
    dark = {"at night": {DARK: [DAY], **tracking.night_clips(clips)}}
    (found,) = (f for f in tracking.findings(table, dark, full=full) if f.claim.startswith(start))
    return found


@pytest.mark.parametrize(("start", "change"), [
    ("Fig. 11", {"day_none": GOOD}), ("Fig. 12", {"day_ours": replace(GOOD, q999_px=1.5)}),
    ("Fig. 12", {"dark_ours": replace(GOOD, lost=1)}), ("IV.B.2", {"dark_back": GOOD}),
    ("IV.B: inverted signals solve", {"dark_ours": replace(GOOD, near=99)}),
])  # fmt: skip
def test_verdicts_follow_the_numbers(start: str, change: dict[str, TrackingScore]) -> None:
    assert finding(fake(), start).verdict == "holds"
    assert not finding(fake(), start).why
    other = finding(fake(**change), start)
    assert other.verdict == "differs"
    assert other.why


def test_a_part_of_the_drive_does_not_refute_fig_11() -> None:
    part = finding(fake(day_none=GOOD), "Fig. 11", full=False)
    assert part.verdict == "shown"
    assert DAY in part.why


@pytest.mark.parametrize(("drawn", "clip", "verdict"), [
    (AWAY, AWAY, "holds"), (GOOD, GOOD, "differs"), (AWAY, GOOD, "shown"), (GOOD, AWAY, "shown"),
])  # fmt: skip
def test_night_is_judged_by_all_dark_films(drawn: TrackingScore, clip: TrackingScore, verdict: str) -> None:
    found = night(drawn, clip, by_day=GOOD)
    assert found.verdict == verdict
    assert "night-road: " in found.ours
    assert ("night-road" in found.why) == (verdict != "holds")


def night(drawn: TrackingScore, clip: TrackingScore, by_day: TrackingScore) -> Finding:
    """Judge the background tracker's scores on a rendered film and a clip at night, and on a clip by day."""
    table = fake(dark_back=drawn)
    for name, one in (("night-road", clip), ("dashcam", by_day)):
        table[name] = table[DARK] | {tracking.BACKGROUND: one}
    return finding(table, "IV.B.2", "dashcam", "night-road")


def test_a_dark_film_is_not_judged_if_the_background_fails_by_day() -> None:
    for clip in (GOOD, AWAY):
        found = night(AWAY, clip, by_day=AWAY)
        assert found.verdict == "holds"
        assert "Not judged: night-road" in found.why
    assert finding(fake(day_back=AWAY), "IV.B.2").verdict == "shown"


def test_the_claim_about_data_rates_depends_on_the_lost_leds() -> None:
    by = {rate.method: rate.kb_s for rate in tracking.rates()}
    assert (by["inverted signals"], by["known pattern"]) == (128, 192)
    assert tracking.rate_finding(tracking.rates()).verdict == "differs"
    assert tracking.rate_finding(tracking.rates(lost=129)).verdict == "holds"
