"""Repeated packets count separately."""

import pytest

from heliograph.experiments.error_rates.repeated_packets import film_settings, measure
from heliograph.experiments.report import Context


def test_the_distance_is_that_of_the_middle_of_the_film() -> None:
    settings = film_settings(100.0, 3)
    channel = settings.channel
    assert channel.duration_s == pytest.approx(0.305)
    assert channel.distance_m - channel.speed_m_s * 0.305 / 2 == pytest.approx(100.0)
    assert film_settings(100.0, 3, ["channel.road_class='A'"]).channel.road_class == "A"


def test_a_near_packet_is_read_in_every_reception_and_a_far_one_in_none() -> None:
    short = ["signal.data_pairs=8"]
    near = measure(film_settings(40.0, 2, short), "middle", 2, 1, Context())
    assert [(one.trials, one.errors) for one in near] == [(2, 0), (2, 0)]
    far = measure(film_settings(600.0, 2, short), "middle", 2, 1, Context())
    assert [(one.trials, one.errors) for one in far] == [(2, 2), (2, 2)]
