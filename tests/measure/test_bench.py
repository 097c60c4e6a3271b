"""The bench counts films and is deterministic in settings and seed."""

from pathlib import Path

import numpy as np
import pytest
from scenes import link as scene_link

from heliograph.base.errors import HeliographError
from heliograph.link.film import frames_of, write_film
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate, transmitters
from heliograph.link.truth import open_truth, truth_path
from heliograph.measure.bench import block_settings, dithered, is_static, random_messages, run_block, window_margin_px
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.media import open_film

OUT_OF_STEP = ("channel.camera.fps=1500", "channel.camera.exposure_s=0.0006", "channel.camera.dropped=0.02",
               "channel.camera.repeated=0.02", "channel.camera.jitter_s=3e-5")  # fmt: skip
SMALL = ("signal.data_pairs=8", "channel.camera.width=320", "channel.camera.height=224")


def link(preset: str, *changes: str) -> LinkSettings:
    return load_settings(preset, None, [*SMALL, *changes])


def by_film(settings: LinkSettings, seed: int, path: Path) -> ReceptionCounter:
    """Return the reception of a film with full frames of the same block."""
    settings = dithered(block_settings(settings), seed)
    write_film(path, settings, random_messages(settings, seed), seed)
    reception = ReceptionCounter(open_truth(truth_path(path)))
    with open_film(path) as film:
        for _ in receive_and_count(film, settings.signal, settings, reception):
            pass
    return reception


@pytest.mark.parametrize(("preset", "changes"), [
    ("static", ("channel.distance_m=40", "receive.receiver=soft", *OUT_OF_STEP)),
    ("paper", ("channel.distance_m=60", "channel.duration_s=0.08")),
    ("static", ("channel.distance_m=100", "receive.receiver=soft")),
    ("two-arrays", ("channel.distance_m=45", "channel.duration_s=0.09", "channel.arrays.1.start_s=0.02")),
])  # fmt: skip
@pytest.mark.slow
def test_bench_and_film_give_equal_counts(preset: str, changes: tuple[str, ...], tmp_path: Path) -> None:
    settings = link(preset, *changes)
    film = by_film(settings, 2, tmp_path / "film.h5")
    counts = run_block(settings, 2)
    assert film.errors is not None
    assert counts.layers == film.errors.total()
    payload = {n: sum(8 * a.layers[n].bytes for a in film.arrays.values()) for n in counts.layers}
    assert counts.payload_bits == payload
    assert sum(payload.values())
    assert (counts.frames, list(counts.bins)) == (film.frames, list(film.errors.bins()))
    assert counts.false_codewords == film.errors.false_codewords == 0
    assert (counts.false_packets, counts.duplicates) == (film.errors.false_packets, film.errors.duplicates)


def test_counts_depend_only_on_settings_and_seed() -> None:
    settings = link("static", "channel.distance_m=70")
    one = run_block(settings, 5)
    assert run_block(settings, 5) == one
    assert run_block(settings, 6) != one


def test_distances_and_processor_time_are_counted() -> None:
    counts = run_block(link("static", "channel.distance_m=40"), 5)
    assert counts.distances == counts.packets == 1
    assert 0 < counts.distance_squares < 0.01**2
    assert counts.receiver_s > 0
    missed = run_block(link("static", "channel.distance_m=300"), 5)
    assert (missed.packets, missed.distances, missed.distance_squares) == (1, 0, 0.0)


@pytest.mark.parametrize("changes", [
    *((f"channel.camera.fps={fps}", f"channel.camera.exposure_s={0.95 / fps}") for fps in (1000, 1300, 2000, 4000)),
    ("channel.camera.dropped=0.1", "channel.camera.gaps=false"), ("channel.camera.dropped=0.6",),
], ids=str)  # fmt: skip
def test_blocks_of_free_running_and_lossy_cameras_have_a_packet(changes: tuple[str, ...]) -> None:
    phase = ("channel.arrays.0.start_s=0.0003", "channel.arrays.0.clock_ppm=100", "receive.receiver=soft")
    assert run_block(link("static", "channel.distance_m=40", *phase, *changes), 3).packets >= 1


def test_no_codeword_is_sent_twice() -> None:
    settings = block_settings(link("paper", "channel.duration_s=0.5"))
    packets = round(0.5 / settings.signal.packet_s)
    (sender,) = transmitters(settings, random_messages(settings, 3))
    for name in ("high", "middle", "low"):
        payloads = [block.payload for number in range(packets + 1) for block in sender.blocks(number)[name]]
        assert (len(set(payloads)), len({len(p) for p in payloads})) == (len(payloads), 1)


def test_packet_cut_by_the_end_of_the_film_is_not_counted() -> None:
    late = link("two-arrays", "channel.speed_m_s=0.0", "channel.shake='none'", "channel.distance_m=40",
                "channel.arrays.1.start_s=0.013")  # fmt: skip
    high = run_block(late, 1).layers["high"]
    assert (high.codewords, high.codeword_errors, high.packets) == (2, 0, 2)


def test_static_blocks_last_a_packet_and_drives_their_duration() -> None:
    static, drive = link("static"), link("paper", "channel.duration_s=0.5")
    assert is_static(static)
    assert not is_static(drive)
    for changed in ("vx_m_s=1", "vy_m_s=1", "vz_m_s=1", "off_s=[[0.02,0.03]]"):
        assert not is_static(link("static", f"channel.arrays.0.{changed}"))
    assert (frames_of(block_settings(static)), frames_of(block_settings(static, 3))) == (20, 3 * 20)
    assert (frames_of(block_settings(drive)), frames_of(block_settings(drive, 2))) == (500, 2 * 20)
    assert frames_of(block_settings(load_settings("static", None, ["signal.data_pairs=998"]))) == 2000


def test_static_arrays_are_placed_within_a_pixel() -> None:
    static = link("static", "channel.distance_m=50")
    places = np.array([(p.x_m, p.y_m) for s in range(200) for p in dithered(static, s).channel.arrays])
    px = (places - places.mean(0)) * static.channel.camera.focal_px / 50
    assert px.std(0) == pytest.approx(np.full(2, 12**-0.5), rel=0.2)
    assert np.abs(px).max() < 0.6
    assert dithered(static, 3) == dithered(static, 3)
    drive = link("paper")
    assert dithered(drive, 3) == drive


@pytest.mark.parametrize(("distance_m", "margin_px"), [(80, 12), (20, 24), (1, 256)])
def test_window_margin_is_half_an_array(distance_m: int, margin_px: int) -> None:
    assert window_margin_px(link("static", f"channel.distance_m={distance_m}")) == margin_px


@pytest.mark.parametrize(("preset", "change", "message"), [
    ("static", "channel.camera.fps=500", "one frame per"), ("paper", "channel.duration_s=0.01", "record longer"),
])  # fmt: skip
def test_unsuitable_settings_raise_an_error_in_one_line(preset: str, change: str, message: str) -> None:
    with pytest.raises(HeliographError, match=message) as caught:
        run_block(link(preset, change), 1)
    assert "\n" not in str(caught.value)


def places(settings: LinkSettings) -> np.ndarray:
    _, truth = next(simulate(settings, default_messages(settings), 0))
    return np.array([(array.x, array.y) for array in truth.arrays])


@pytest.mark.slow
def test_images_move_by_half_a_pixel_at_most() -> None:
    """The two arrays are nearer and farther than the scene distance."""
    arrays = "[{x_m=-0.4, y_m=0.0, z_offset_m=-20.0}, {x_m=0.4, y_m=0.1, z_offset_m=30.0}]"
    settings = scene_link(f"channel.arrays={arrays}", "transmit.identities=[0, 7]", "channel.duration_s=0.001")
    moves = np.array([places(dithered(settings, seed)) for seed in range(60)]) - places(settings)
    assert np.abs(moves).max() < 0.501
    # both arrays cover almost the full pixel in both directions, and their positions are uncorrelated
    assert moves.min(0) == pytest.approx(-0.5, abs=0.06)
    assert moves.max(0) == pytest.approx(0.5, abs=0.06)
    assert abs(np.corrcoef(moves[:, 0, 0], moves[:, 1, 0])[0, 1]) < 0.4
