"""A film with signal metadata different from the settings; metadata take precedence over estimates."""

from pathlib import Path

import pytest
from scenes import link

from heliograph.link.film import write_film
from heliograph.link.truth import departures, signal_of
from heliograph.media import open_film
from heliograph.probe import probe_film
from heliograph.probe.words import in_sentences, in_short, lines


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "a.h5"
    settings = link("channel.camera.width=48", "channel.camera.height=48", "channel.duration_s=0.04")
    write_film(path, settings, [{"high": [b"red"]}], seed=1)
    return path


@pytest.mark.parametrize(("key", "value"), [("data_pairs", 24), ("slot_order", [1, 0, 2, 3]), ("rate.low", 0.5)])
@pytest.mark.slow
def test_each_differing_setting_is_named_with_both_values(key: str, value: object, film: Path) -> None:
    settings = link(f"signal.{key}={value!r}")
    with open_film(film) as source:
        ((named, ours, noted),) = departures(source, settings.signal)
        assert (named, ours) == (f"signal.{key}", value)
        found = probe_film(source, settings.signal, settings.receive, reading=False)
    assert [cause.kind for cause in found.causes] == ["other settings"]
    assert f"signal.{key} is {ours}, and the film's note says {noted}" in found.causes[0].why
    assert found.advice[0].startswith(f"leave signal.{key} out, or write --set 'signal.{key}=")
    assert len(found.advice) == 1
    assert not any(region.causes for region in found.regions)
    for words in (lines(found), in_short(found), in_sentences(found)):
        assert "the film's note says" in "\n".join(words)


def test_settings_of_the_note_do_not_differ(film: Path) -> None:
    with open_film(film) as source:
        signal, _ = signal_of(source, link("signal.data_pairs=24").signal)
        assert departures(source, signal) == []
        source.metadata = {}
        assert departures(source, link("signal.data_pairs=24").signal) == []
        source.metadata = {"heliograph_signal": "{no JSON"}
        assert departures(source, signal) == []
