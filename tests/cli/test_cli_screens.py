"""Screen films on the command line: advice on the correct option, and a hidden screen."""

from pathlib import Path

import numpy as np
import pytest
from cli_runs import failed, succeeded, within
from film_checks import write_levels
from screen_films import Phone, phone_frames, write_phone_film
from screen_light import shown

from heliograph.web.sending import sending_of

PHONE = Phone(width=320, height=240, side_px=160.0, blur_px=0.8, seed=5)


@pytest.mark.slow
def test_a_phone_film_is_recognised_and_another_receiver_refuses_it(tmp_path: Path) -> None:
    grabs = shown(sending_of(b"Hello from a laptop", None, 16, 10.0), 6.5, cell_px=8)
    write_phone_film(tmp_path / "phone.mp4", phone_frames(grabs, PHONE), PHONE)
    lines = succeeded(within(tmp_path, "receive", "phone.mp4")).splitlines()
    assert lines[0].startswith("receiver screen: the film shows a screen: 16 x 16 cells")
    assert "array 0, high, message 0: 19 bytes, 'Hello from a laptop'" in lines
    run = within(tmp_path, "receive", "phone.mp4", "--receiver", "plain")
    advice = [line for line in run.stdout.splitlines() if line.startswith("  - ")]
    assert advice == ["  - read it by --preset phone, which chooses --receiver screen"]
    assert "phone.mp4 shows a screen: read it by --preset phone" in failed(run)


@pytest.mark.slow
def test_receive_reports_a_missing_screen_early_and_at_the_end(tmp_path: Path) -> None:
    write_levels(tmp_path / "empty.h5", np.random.default_rng(1).integers(90, 110, (170, 48, 64), np.uint8), 30)
    run = within(tmp_path, "receive", "empty.h5", "--preset", "phone")
    assert "no readable screen is visible, in the first 5.0 s" in failed(run, 3)
    assert "no array found: no readable screen is visible" in run.stdout
