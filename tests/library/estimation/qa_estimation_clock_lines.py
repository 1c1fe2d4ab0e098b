# SPDX-License-Identifier: GPL-3.0-or-later
"""Clocks of wide tolerance are found among the lines of a room, and read as well as crystals."""

import numpy as np
import plain
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.estimation.room.survey import survey_channel
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.adaptation import adapted
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver.recording_reader import RecordingReader
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate
from press_capture import SCENE
from wiforce_app.bench.air import TagOnAir

COUNT = 8192
NARROW = {"name": "arm", "model": "line-900mhz-calibrated"}
WIDE = NARROW | {"clock_tolerance_ppm": 20_000.0}


def survey_of(tags, clocks, seed=1, gamma_db=20.0, lamps_db=None):
    """Survey of 0.47 s."""
    rng = np.random.default_rng([seed, 5])
    ends_deg = rng.uniform(-180, 180, (len(tags), 2))
    tags = [
        TagOnAir(**tag, start_cycles=rng.random(), untouched_deg=tuple(ends))
        for tag, ends in zip(tags, ends_deg, strict=True)
    ]
    air = plain.make_air(COUNT, tags, seed, gamma_db, static_db=50.0)
    channel = air.group(0).astype(complex)
    if lamps_db is not None:
        t = np.arange(COUNT) * plain.T
        light = sum(np.cos(200 * np.pi * k * t + k) / k for k in range(1, 60))
        channel += 0.225 * 10 ** (lamps_db / 20) * light[:, None] * air.channels[0]
    return survey_channel(channel, plain.WAVEFORM, clocks, (50.0, 60.0))


def surveyed(tags, clocks, *args, **more):
    """Frequencies that a survey finds for the first tags, in Hz; none has a rival."""
    found = survey_of(tags, clocks, *args, **more)
    assert [line.rival_hz for line in found.clocks] == [None] * len(clocks)
    return np.array([line.clock_hz if line.found else np.nan for line in found.clocks])


@pytest.mark.parametrize("offset_ppm", [-19_500.0, 8000.0, 19_500.0])
@pytest.mark.parametrize("clock_hz", [500.0, 1000.0, 2000.0])
def test_clock_is_found_within_two_percent(clock_hz, offset_ppm):
    """An oscillator without a crystal is anywhere in its tolerance."""
    tag = {"clock_hz": clock_hz, "offset_ppm": offset_ppm}
    (found,) = surveyed([tag], [TagClock(clock_hz, 20_000.0)], gamma_db=0.0)
    assert found == pytest.approx(clock_hz * (1 + offset_ppm * 1e-6), rel=5e-5)


def test_stronger_line_of_another_tag_is_not_taken_for_a_harmonic():
    """Its clock was found 0.15 % off, and none of its readings could be used."""
    tags = [{"clock_hz": 1035.0}, {"clock_hz": 691.0}]  # line 2 of one beside line 3 of the other
    found = surveyed(tags, [TagClock(1035.0, 100.0), TagClock(691.0, 100.0)])
    np.testing.assert_allclose(found, [1035.0, 691.0], rtol=1e-5)


@pytest.mark.parametrize("offset_ppm", [-15_000.0, 12_000.0])
@pytest.mark.parametrize(
    "strangers, lamps_db",
    [
        ([{"clock_hz": 500.0, "level_db": 10.0}], None),  # lines 2 and 4 at our nominal lines
        ([{"clock_hz": 335.0, "level_db": 20.0}], None),  # line 3 within our tolerance
        ([{"clock_hz": 1300.0, "level_db": 30.0}], None),
        ([], 40.0),  # lines at every multiple of 1000 Hz, as a tag has
    ],
)
def test_clock_is_not_taken_from_another_tag_or_lamps(strangers, lamps_db, offset_ppm):
    """Tones at a stranger's lines would give its phases as those of our sensor."""
    own = {"clock_hz": 1000.0, "offset_ppm": offset_ppm}
    (found,) = surveyed([own, *strangers], [TagClock(1000.0, 20_000.0)], lamps_db=lamps_db)
    assert found == pytest.approx(1000 * (1 + offset_ppm * 1e-6), rel=5e-5)


@pytest.mark.parametrize("level_db", [-15.0, 15.0])
@pytest.mark.parametrize("rival_hz", [1009.0, 985.0])
def test_second_tag_within_tolerance_is_reported(rival_hz, level_db):
    """Nobody can say which of both is pressed: to read either would be a guess."""
    tags = [{"clock_hz": 1003.0}, {"clock_hz": rival_hz, "level_db": level_db}]
    (line,) = survey_of(tags, [TagClock(1000.0, 20_000.0)]).clocks
    found = sorted((line.clock_hz, line.rival_hz))
    np.testing.assert_allclose(found, sorted((1003.0, rival_hz)), rtol=3e-4)
    (narrow,) = survey_of(tags, [TagClock(1003.0, 100.0)]).clocks
    assert narrow.rival_hz is None
    scene = load_scene({"sensors": [WIDE]})
    with pytest.raises(InputError, match=r"sensors\[0\].clock_hz: must say which tag is meant"):
        adapted(plan(scene), survey_of(tags, [TagClock(1000.0, 20_000.0)]))


def test_lamps_alone_are_no_tag():
    """A tag that is off must not be acquired at a multiple of the mains frequency."""
    off = {"clock_hz": 1000.0, "level_db": -100.0}
    found = surveyed([off], [TagClock(1000.0, 20_000.0)], lamps_db=40.0)
    assert np.isnan(found).all()


@pytest.mark.parametrize("seed", [1, 2])
def test_tags_of_wide_tolerance_keep_apart(seed):
    """Each sensor has to be read from its own tag, whichever is stronger."""
    rng = np.random.default_rng(seed)
    nominal, ppm = [1000.0, 1400.0, 1900.0], rng.uniform(-19_000, 19_000, 3)
    tags = [
        {"clock_hz": hertz, "offset_ppm": offset, "level_db": level}
        for hertz, offset, level in zip(nominal, ppm, rng.permutation([0, 10, 20]), strict=True)
    ]
    found = surveyed(tags, [TagClock(hertz, 20_000.0) for hertz in nominal], seed)
    np.testing.assert_allclose(found, nominal * (1 + ppm * 1e-6), rtol=1e-4)


def test_tag_two_percent_off_is_read_like_a_crystal(tmp_path):
    """At 1.75 % line 4 lies two groups' resolution from where the scene states it."""

    def errors_n(sensor, offset_ppm):
        press = {"start_s": 0.7, "rise_s": 0.05, "hold_s": 0.5, "force_n": 4.0, "location_mm": 40.0}
        simulation = {"duration_s": 1.4, "clock_offset_ppm": offset_ppm, "presses": [press]}
        sections = {"sensors": [sensor], "simulation": simulation, "reference_s": 0.5}
        scene = load_scene(SCENE | sections)
        path = simulate(scene, tmp_path / f"{offset_ppm:g}")[0]
        batches = []
        reader = RecordingReader(open_capture(path), plan(scene), on_groups=batches.append)
        readings = [reading for batch in reader for reading in batch]
        offsets = np.concatenate([batch.clock_offset_ppm[:, 0] for batch in batches])
        pressed = [r.force_n for r in readings if 0.8 < r.time_s < 1.2 and not r.flags]
        assert len(pressed) >= 9
        return np.abs(np.array(pressed) - 4.0), offsets

    wide, offsets = errors_n(WIDE, 17_500.0)
    crystal, _ = errors_n(NARROW, 40.0)
    assert np.median(wide) == pytest.approx(np.median(crystal), abs=0.03)
    np.testing.assert_allclose(offsets, 17_500, atol=1)


def test_wide_tolerance_is_refused_where_nothing_is_surveyed():
    """Weights that were designed for the nominal clock would never find it."""
    scene = load_scene({"sensors": [WIDE], "reference_s": 0.08})
    rule = r"sensors\[0\].clock_tolerance_ppm: must be at most 1000 here: a wider one is searched"
    for make in (wiforce.Receiver, wiforce.end_separation, wiforce.reader):
        with pytest.raises(InputError, match=rule):
            make(plan(scene))


def test_tags_that_could_coincide_are_refused():
    """Two clocks that are 3 % apart and 2 % unsure cannot be distinguished."""
    other = WIDE | {"name": "leg", "clock_hz": 1030.0}
    with pytest.raises(InputError, match="must lie 40.6 Hz or more from the clock of"):
        load_scene({"sensors": [WIDE, other]})
