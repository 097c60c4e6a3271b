"""Fig. 13: counts per packet, and the comparison of moving and static films."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.experiments import plots
from heliograph.experiments.error_rates import experiment, real_input, scenes
from heliograph.experiments.error_rates.real_input import EmptyCounts, RealScene
from heliograph.experiments.error_rates.repeated_packets import film_settings, measure
from heliograph.experiments.report import Context
from heliograph.link.film import write_film
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.bench import run_block
from heliograph.measure.counts import BlockCounts, LayerCounts
from heliograph.measure.statistics import Count
from heliograph.receive.api import make_receiver
from heliograph.receive.packet import Packet, Receiver
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import ARROW, BOUND, legend_entries

NONE_LOST = Count(200, 0), Count(200, 0)
Records = list[experiment.PacketRecord]


def records(rate: float, count: int, rng: np.random.Generator) -> Records:
    """Draw packets at 50 m to 60 m with overdispersed error rates."""
    out = []
    for z in np.linspace(50.1, 59.9, count):
        errors = rng.binomial(3072, min(rate * rng.lognormal(0, 0.3), 0.5), 3)
        layers = {n: LayerCounts(raw_bits=3072, raw_errors=int(e)) for n, e in zip(LAYERS, errors, strict=True)}
        out.append(experiment.PacketRecord(float(z), layers))
    return out


@pytest.mark.parametrize(("seed", "factor", "packets", "verdicts", "verdict"), [
    (0, 1.0, 200, {"alike"}, "holds"), (1, 1.9, 120, {"apart"}, "differs"), (2, 1.5, 4, {"open"}, "shown"),
])  # fmt: skip
def test_rates_are_alike_or_apart(seed: int, factor: float, packets: int, verdicts: set[str], verdict: str) -> None:
    rng = np.random.default_rng(seed)
    found = experiment.compare(records(0.02 * factor, packets, rng), records(0.02, packets, rng), rng)
    assert {c.bin_m for c in found} <= {52.5, 57.5, None}
    assert len(found) == 9 or packets == 4
    assert ({c.verdict for c in found}, experiment.alike(found, *NONE_LOST).verdict) == (verdicts, verdict)
    assert verdict != "differs" or all(1.6 < c.ratio < 2.3 for c in found)


@pytest.mark.parametrize(("p", "corrected"), [([0.01, 0.04, 0.03], [0.03, 0.06, 0.06]), ([0.5, 0.9], [1, 1]), ([], [])])
def test_p_values_are_corrected_by_holms_method(p: list[float], corrected: list[float]) -> None:
    assert experiment.holm(p) == pytest.approx(corrected)


def pair(rate: float, count: int, seed: int) -> tuple[Records, Records, np.random.Generator]:
    """Draw packets of two films with equal rates."""
    rng = np.random.default_rng(seed)
    return records(rate, count, rng), records(rate, count, rng), rng


@pytest.mark.slow
def test_false_alarms_are_rare_despite_large_variation_between_packets() -> None:
    compared = [experiment.compare(*pair(0.01, 20, seed)) for seed in range(20)]
    assert np.mean([c.verdict == "apart" for found in compared for c in found]) < 0.02


def test_lost_packets_count_and_zero_packets_decide_no_claim() -> None:
    found = experiment.compare(*pair(0.02, 200, 0))
    worse = experiment.alike(found, Count(200, 20), Count(200, 2))
    assert worse.verdict == "differs"
    assert "20 of 200 driving, 2 of 200 at rest" in worse.ours
    assert "lost" in worse.why
    for lost, verdict in (
        ((Count(200, 2), Count(200, 20)), "holds"), ((Count(20, 1), Count(20, 0)), "shown"), ((Count(),) * 2, "shown")
    ):  # fmt: skip
        assert experiment.alike(found, *lost).verdict == verdict
    assert experiment.compare([], [], np.random.default_rng(0)) == []
    assert experiment.alike([], *NONE_LOST).verdict == "shown"


def test_different_drives_widen_the_interval() -> None:
    drives, (one, other, _) = [k % 4 for k in range(200)], pair(0.02, 200, 4)
    one = [
        replace(r, layers={n: replace(c, raw_errors=c.raw_errors * (k + 1) // 2) for n, c in r.layers.items()})
        for k, r in zip(drives, one, strict=True)
    ]
    plain, by_drive = (experiment.compare(one, other, np.random.default_rng(5), drives=d)[-1] for d in ((), drives))
    assert by_drive.ratio == plain.ratio
    assert by_drive.high - by_drive.low > 2 * (plain.high - plain.low)


def test_unread_layers_are_not_compared() -> None:
    one, other, rng = pair(0.02, 50, 6)
    other[0] = replace(other[0], layers={**other[0].layers, "low": LayerCounts()})
    pairs = {c.layer: c.pairs for c in experiment.compare(one, other, rng) if c.bin_m is None}
    assert pairs == {"high": 50, "middle": 50, "low": 49}


@pytest.mark.parametrize(("counts", "verdict", "why"), [
    (LayerCounts(codewords=1000, sent_packets=1000), "holds", ""),
    (LayerCounts(codewords=100, sent_packets=100), "shown", "Too few"),
    (LayerCounts(codewords=1000, sent_packets=100), "shown", "Too few"),
    (LayerCounts(raw_bits=1000, raw_errors=20, codewords=100, codeword_errors=5), "differs", ""),
    (LayerCounts(raw_bits=1000, raw_errors=200, codewords=100, codeword_errors=5), "differs", "too much"),
    (LayerCounts(0, 0, 1000, 200, 100, 5, 5), "differs", "5 of the 5 wrong codewords are of packets not received."),
    (LayerCounts(0, 0, 1000, 200, 100, 5, 2), "differs", "2 of the 5 wrong"),
    (LayerCounts(), "shown", "Too few"),
])  # fmt: skip
def test_reasons_of_wrong_codewords(counts: LayerCounts, verdict: str, why: str) -> None:
    finding = next(experiment.error_free(experiment.CountsByDistance({77.5: dict.fromkeys(LAYERS, counts)})))
    assert finding.verdict == verdict
    assert why in finding.why
    assert bool(finding.why) == bool(why)
    assert ("too much" in finding.why) == (counts.raw_errors == 200 and counts.missed < counts.codeword_errors)


class RepeatingReceiver:
    def __init__(self, receiver: Receiver, times: int):
        self.receiver, self.times = receiver, times

    def push(self, frame: Frame) -> list[Packet]:
        return [packet for packet in self.receiver.push(frame) for _ in range(self.times)]


@pytest.mark.parametrize(("times", "packets", "lost"), [(0, 0, 1), (2, 1, 0)])
@pytest.mark.slow
def test_lost_and_repeated_packets(monkeypatch: pytest.MonkeyPatch, times: int, packets: int, lost: int) -> None:
    monkeypatch.setattr(experiment, "make_receiver", lambda *args: RepeatingReceiver(make_receiver(*args), times))
    one = experiment.count_film(experiment.FilmTask(35.0, "haar", (7,)))
    assert (len(one.packets), list(one.lost)) == (packets, [37.5] * lost)
    assert experiment.lost_packets([one, one]) == Count(2, 2 * lost)


@pytest.mark.slow
def test_packets_of_a_drive_add_up_to_the_count_of_a_block() -> None:
    settings = load_settings("paper", {"channel": {"distance_m": 62.0, "duration_s": 0.25}})
    one = experiment.film_packets(settings, np.random.default_rng(4))
    assert (len(one.packets), one.false_codewords) == (2, 0)
    assert all(55 < record.distance_m < 62 for record in one.packets)
    distances = [record.distance_m for record in one.packets]
    assert distances == sorted(distances, reverse=True)
    block = run_block(settings, int(np.random.default_rng(4).integers(2**31)), max_packets=None)
    for name in LAYERS:
        total = sum((record.layers[name] for record in one.packets), LayerCounts())
        assert replace(total, missed=0) == replace(block.layers[name], missed=0)
        assert total.raw_errors > 0


def test_on_off_keying_end_to_end() -> None:
    """At short range all layers with on-off keying arrive, and the error counter counts each bit."""
    settings = load_settings("static", {"signal": {"modulation": "ook"}, "channel": {"distance_m": 35.0}})
    block = run_block(settings, 5, max_packets=2)
    assert (block.packets, block.false_codewords) == (2, 0)
    assert {name: block.layers[name].raw_bits for name in LAYERS} == {"high": 6144, "middle": 12288, "low": 6144}
    assert all(block.layers[name].raw_errors == block.layers[name].bit_errors == 0 for name in LAYERS)


def test_on_off_keying_errors_are_alike_in_all_layers() -> None:
    one = experiment.count_film(experiment.FilmTask(60.0, "ook", (6,)))
    rates = [one.packets[0].layers[name].raw_errors / one.packets[0].layers[name].raw_bits for name in LAYERS]
    assert min(rates) > 0.03
    assert max(rates) < 0.2


@pytest.mark.slow
def test_result(monkeypatch: pytest.MonkeyPatch) -> None:
    short = load_settings("paper", {"channel": {"distance_m": 66.0, "duration_s": 0.34}})
    monkeypatch.setattr(experiment, "load_settings", lambda *_: short)
    done: list[float] = []
    context = Context(progress=lambda _, share: done.append(share))
    result = experiment.run(context, experiment.ErrorRateEffort([30.0, 60.0], films=1, drives=1))
    assert result.text == "1 static films a distance; 1 drives, shaken by a road of class B, in bins of 5 m."
    assert done == sorted(done)
    assert done[-1] == pytest.approx(1)
    data = json.loads(json.dumps(result.data))
    assert ([row["distance_m"] for row in data["static"]], data["static"][0]["low"]["raw_errors"]) == ([30.0, 60.0], 0)
    assert data["static"][1]["low"]["raw_bits"] == 3072
    assert 0.05 < data["static"][1]["low"]["raw_errors"] / 3072 < 0.3
    assert data["driving"]
    assert data["false_codewords"] == 0
    assert all(np.isfinite([c["ratio"], c["p"]]).all() for c in data["comparison"])
    assert [f.verdict for f in result.findings][1] == "shown"
    assert data["lost"]["driving"]["trials"] == data["lost"]["static"]["trials"] > 0
    assert len(result.pictures) == 2
    assert all(len(row) == len(t.head) for t in result.tables for row in t.rows)


def test_all_scenes_have_different_settings() -> None:
    found = [scenes.scene_settings(name, 50.0) for name in scenes.SCENES]
    assert all(one not in found[:k] for k, one in enumerate(found))
    assert {one.receive.receiver for one in found} == {"soft"}
    assert len(scenes.scene_settings("six arrays", 50.0).channel.arrays) == 6


@pytest.mark.slow
def test_blocks_are_counted_by_scene_and_distance() -> None:
    found = scenes.measure(["upright"], [30.0, 300.0], range(2), "plain", Context())
    near, far = found["upright", 30.0], found["upright", 300.0]
    assert (near.layers["middle"].codewords, near.layers["middle"].codeword_errors) == (4, 0)
    assert far.layers["high"].missed == 2


def test_a_line_names_wrong_missed_and_false_codewords() -> None:
    layers = {"high": LayerCounts(codewords=6), "low": LayerCounts(codewords=6, codeword_errors=3, missed=1)}
    text = scenes.counts_text(BlockCounts(layers, false_codewords=2))
    assert text.startswith("high 0/6 [0.0e+00, ")
    assert "low 3/6 (1 missed) [" in text
    assert text.endswith("false codewords 2, packets of nothing 0")


@pytest.mark.parametrize(("distance_m", "lost"), [(40.0, 0), (600.0, 2)])
def test_a_near_packet_is_read_in_every_reception_and_a_far_one_in_none(distance_m: float, lost: int) -> None:
    counts = measure(film_settings(distance_m, 2, ["signal.data_pairs=8"]), "middle", 2, 1, Context())
    assert [(one.trials, one.errors) for one in counts] == [(2, lost)] * 2


def test_the_distance_is_that_of_the_middle_of_the_film() -> None:
    channel = film_settings(100.0, 3, ["channel.road_class='A'"]).channel
    assert channel.road_class == "A"
    assert channel.duration_s == pytest.approx(0.305)
    assert channel.distance_m - channel.speed_m_s * 0.305 / 2 == pytest.approx(100.0)


def test_no_line_joins_a_bound() -> None:
    axes = Figure().add_subplot()
    counts = (Count(100, 0), Count(100, 5), Count(0, 0), Count(12, 0), Count(5, 0))
    plots.draw_rates(axes, list(zip((40.0, 60.0, 80.0, 100.0, 120.0), counts, strict=True)), "soft", color="C0")
    joined = [line for line in axes.lines if line.get_linestyle() != "None"]
    assert [np.asarray(line.get_xdata()).tolist() for line in joined] == [[60.0]]
    (bounds,) = (line for line in axes.lines if line.get_marker() == ARROW)
    # a bound of 0.6 is no measurement
    assert (np.asarray(bounds.get_ydata()).tolist(), legend_entries(axes)[1]) == ([0.03, 0.25], ["soft", BOUND])


def test_no_error_is_drawn_as_a_bound_of_three_by_n_and_named_in_the_legend() -> None:
    layers = {"high": LayerCounts(bits=6000), "middle": LayerCounts(), "low": LayerCounts(bits=1000, bit_errors=10)}
    after = plots.errors_by_distance({50.0: layers}).axes[1]
    points = [(float(x), float(y)) for line in after.lines for x, y in np.array(line.get_xydata())]
    assert (52.5 - 0.7, 3 / 6000) in points  # each layer is drawn a little aside
    assert (52.5 + 0.7, 0.01) in points
    bins = {40.0: {name: LayerCounts(raw_bits=1000) for name in LAYERS}}
    (legend,) = plots.errors_by_distance(bins).legends
    assert [text.get_text() for text in legend.get_texts()] == [*LAYERS, BOUND]


SMALL = ("channel.camera.width=192", "channel.camera.height=160", "channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0")


def scene(data: Path, clip: str, seed: int, *changes: str) -> RealScene:
    return RealScene(data / "driving" / f"{clip}.mp4", data / "motion" / "car-imu.csv", seed, changes)


@pytest.mark.real_data
@pytest.mark.parametrize(("clip", "distance_m", "readable"), [("day-shade", 75, 1), ("night-road", 45, 3)])
@pytest.mark.slow
def test_layers_are_read_over_real_footage_and_shake(data: Path, clip: str, distance_m: int, readable: int) -> None:
    drive = scene(data, clip, 1, f"channel.distance_m={distance_m}", "channel.duration_s=0.24")
    found = real_input.drive(drive, 16)  # film only the array and a margin, for speed
    assert found.frames == 240
    assert found.errors is not None
    total = found.errors.total()
    # two packets are completely filmed
    assert {n: e.codewords for n, e in total.items()} == {"high": 2, "middle": 4, "low": 2}
    assert [total[n].codeword_errors for n in ("high", "middle", "low")[:readable]] == [0] * readable
    assert found.errors.false_codewords == 0


@pytest.mark.real_data
@pytest.mark.parametrize(("clip", "native"), [("day-shade", False), ("night-road", True)])
@pytest.mark.slow
def test_a_clip_without_an_array_has_no_packet(data: Path, clip: str, native: bool) -> None:
    # short packets, so that a packet from a false detection ends within the clip
    small = ("signal.data_pairs=8", "channel.camera.width=480", "channel.camera.height=270")
    film = scene(data, clip, 3, "channel.duration_s=0.04", *small)
    found = real_input.empty(film, 20 if native else None, native=native)
    assert (found.frames, found.right, found.words) == (20 if native else 40, 0, 0)
    # a false detection of native frames costs little time, but a valid codeword from noise is a wrong message
    assert found.detections <= (1 if native else 0)


def test_counts_of_empty_films_add_up() -> None:
    total = EmptyCounts(100, 1, 1, 0, 2, 3) + EmptyCounts(100, 1, 1, 0, 2, 3)
    assert (total.frames, total.detections, total.words, total.without_header) == (200, 2, 4, 6)
    assert "0/200 (< 1.5e-02) packets with a right codeword" in total.text()


@pytest.mark.slow
def test_a_transcoded_film_is_compared_with_the_original_truth(tmp_path: Path) -> None:
    settings = load_settings("static", None, ["channel.distance_m=30", "channel.duration_s=0.11", *SMALL])
    film, again = tmp_path / "film.mp4", tmp_path / "again.mp4"
    write_film(film, settings, default_messages(settings), 5, lossless=True)
    with pytest.raises(MediaError, match="is the film itself"):
        real_input.encode_again(film, film)
    real_input.encode_again(film, again)
    assert again.stat().st_size < film.stat().st_size
    reception = real_input.receive_again(again, open_truth(truth_path(film)))
    assert reception.errors is not None
    lines = list(real_input.error_lines(reception.errors))
    assert (lines[0], lines[-1]) == ("30-35 m: high 0/1, middle 0/2, low 0/1", "false codewords 0, false packets 0")
