# SPDX-License-Identifier: GPL-3.0-or-later
"""The survey of a room: what it finds in snapshots, and what the plan makes of it."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.estimation.room.survey import survey_channel
from gnuradio.wiforce.planning.adaptation import (
    adapted,
    expecting_snr,
    room_noise_of_tones,
)
from gnuradio.wiforce.planning.findings import findings
from gnuradio.wiforce.planning.plan import Plan, plan
from gnuradio.wiforce.signal.lines import RoomNoise
from gnuradio.wiforce.signal.waveform import sounding_waveform
from gnuradio.wiforce.signal.weights import design_weights
from plain import normal

WAVEFORM = sounding_waveform()
T = WAVEFORM.snapshot_period_s
COUNT, CARRIERS = 8192, 62
OWN_HZ, STATIC = 1040.03, 300.0
TIME_S = T * np.arange(COUNT)


def db(ratio):
    return 10 * np.log10(ratio)


def square(clock_hz, seed):
    """A tag that two switches connect: on for 1/4 of the period, half a period apart."""
    rng = np.random.default_rng(seed)
    fine = 16  # instants over the averaged part of a frame
    within_s = (np.arange(fine) + 0.5) / fine * WAVEFORM.averaging_s
    cycles = clock_hz * (TIME_S[:, None] + within_s)
    # Clock 1 with pulses of 1/4 period, clock 2 with two pulses of 1/8 at twice the frequency.
    first = np.mean((cycles % 1) < 0.25, axis=1)
    second = np.mean(((2 * (cycles - 0.375)) % 1) < 0.25, axis=1)
    phases = np.exp(2j * np.pi * rng.random((2, 1, CARRIERS)))
    return phases[0] * first[:, None] + phases[1] * second[:, None]


def room(*parts, noise=1.0):
    """Channel of a room: static path, the scene's tag, noise, and what is given; (COUNT, 62)."""
    white = normal(np.random.default_rng(1), COUNT, CARRIERS)
    return sum(parts, STATIC + noise * white + 4 * square(OWN_HZ, 0))


def lamps(mains_hz, amplitude):
    """Lines at all multiples of twice the mains frequency, falling as 1/h."""
    orders = np.arange(1, int(8000 / (2 * mains_hz)))
    phase = np.random.default_rng(7).random(len(orders))
    turns = 2 * np.pi * (np.outer(TIME_S, 2 * mains_hz * 1.0002 * orders) + phase)
    return (2 * amplitude * np.cos(turns) @ (1 / orders))[:, None]


def walker(fastest_hz):
    """Doppler lines at random frequencies up to a highest one; mean power 40^2."""
    rng = np.random.default_rng(5)
    hertz = np.r_[rng.uniform(-fastest_hz, fastest_hz, 60), fastest_hz, -fastest_hz]
    gains = 40 * np.exp(2j * np.pi * rng.random((len(hertz), CARRIERS))) / np.sqrt(len(hertz))
    return np.exp(2j * np.pi * np.outer(TIME_S, hertz)) @ gains


def settings(**environment):
    sensor = {"name": "arm", "model": "line-900mhz", "clock_hz": 1040.0}
    return plan({"sensors": [sensor], "environment": environment})


@pytest.fixture(scope="module")
def own_plan():
    return settings()


def surveyed(channel, planned):
    mains_hz = planned.scene.environment.possible_mains_hz
    return survey_channel(channel, WAVEFORM, planned.clocks, mains_hz)


@pytest.mark.parametrize("frequency_hz, power", [(1300.0, 0.1), (2711.3, 3.0), (7103.77, 0.02)])
def test_line_has_true_frequency_and_power(own_plan, frequency_hz, power):
    """A line reported elsewhere, or at another level, would be looked for in vain."""
    # Equal lines at +f and -f, of this power each.
    tone = 2 * np.sqrt(power) * np.cos(2 * np.pi * frequency_hz * TIME_S + 1)
    survey = surveyed(room(tone[:, None]), own_plan)
    (line,) = survey.sources
    assert line.kind == "line"
    assert line.fundamental_hz == pytest.approx(frequency_hz, abs=0.2)
    assert db(line.power / power) == pytest.approx(0, abs=1)


def test_static_and_own_line_have_true_power(own_plan):
    """All levels refer to line 1."""
    survey = surveyed(room(), own_plan)
    harmonic = np.exp(-2j * np.pi * OWN_HZ * TIME_S)
    tag = 4 * square(OWN_HZ, 0)
    powers = [
        np.mean(np.abs(np.mean(tag * h[:, None], axis=0)) ** 2) for h in (harmonic, 1 / harmonic)
    ]
    assert db(survey.line_power[0] / np.mean(powers)) == pytest.approx(0, abs=0.5)
    static = np.abs(np.mean(room(noise=0), axis=0)) ** 2
    assert db(survey.static_power / np.mean(static)) == pytest.approx(0, abs=0.3)
    assert survey.sources == [] and survey.moving_hz() == 0
    # Each bin is noise of mean 1, outside the lines of the tag.
    assert np.median(survey.spectrum) == pytest.approx(1, abs=0.03)


def test_lamps_are_recognised_by_their_mains_where_it_is_possible():
    """``environment.mains_hz`` excludes the other frequency, and null excludes lamps."""
    for hertz, allowed in itertools.product((50.0, 60.0), (50, 60, None)):
        channel = room(lamps(hertz, 2.0))
        found = surveyed(channel, settings(mains_hz=allowed)).sources
        if hertz != allowed:
            assert "lamps" not in {each.kind for each in found} and found
            continue
        (source,) = found
        assert (source.kind, source.fundamental_hz) == ("lamps", 2 * hertz)
        assert db(source.power / 4.0) == pytest.approx(0, abs=1)
        lines = {round(line.frequency_hz / (2 * hertz)) for line in source.lines}
        assert {1, 2, 3, 4, 5} <= lines


def test_lamps_leave_hum_of_half_their_frequency_alone(own_plan):
    """A ripple of 50 Hz must not be hidden as an alias of the lamps' highest lines."""
    hum = 20 * np.cos(2 * np.pi * 50 * TIME_S)[:, None]
    sources = surveyed(room(lamps(50, 8.0), hum), own_plan).sources
    assert sorted(source.kind for source in sources) == ["lamps", "line"]
    (line,) = [source for source in sources if source.kind == "line"]
    assert line.fundamental_hz == pytest.approx(50, abs=0.2)
    found = findings(surveyed(room(hum), own_plan), own_plan, own_plan)
    assert [each.kind for each in found] == ["line"] and "hum" in found[0].meaning


@pytest.mark.parametrize("clock_hz", [1300.04, 1790.1])
def test_unlisted_tag_is_identified_and_solved_for(own_plan, clock_hz):
    """An unlisted tag that is not solved for makes all readings wrong."""
    survey = surveyed(room(1.5 * square(clock_hz, 3)), own_plan)
    tags = [source for source in survey.sources if source.kind == "tag"]
    assert [tag.fundamental_hz for tag in tags] == [pytest.approx(clock_hz, abs=0.1)]
    better = adapted(own_plan, survey)
    assert [other.clock_hz for other in better.others] == [tags[0].fundamental_hz]
    (finding,) = [each for each in findings(survey, own_plan, better) if each.kind == "tag"]
    assert finding.handling.startswith("solved for") and finding.matters
    # Both ends have a line at twice the clock, the first end one at the clock: (1 + 1/2) as strong.
    expected = 20 * np.log10(1.5 / 4) + db(1.5)
    assert finding.level_db == pytest.approx(expected, abs=0.5)


def test_tag_whose_even_lines_hide_under_ours_is_found(own_plan):
    """Half of our clock: the odd lines alone show the tag, and its even ones disturb ours."""
    survey = surveyed(room(3 * square(OWN_HZ / 2 - 0.02, 3)), own_plan)
    (tag,) = [source for source in survey.sources if source.kind == "tag"]
    assert tag.fundamental_hz == pytest.approx(OWN_HZ / 2 - 0.02, abs=0.1)
    (finding,) = findings(survey, own_plan, adapted(own_plan, survey))
    assert "coincides with lines 1, 2 and 4 of 'arm'" in finding.handling


def test_fan_is_no_tag(own_plan):
    """Weights against harmonics of a fan's blades, where there are none, would cost accuracy."""
    blades = sum(
        5 / m * np.exp(2j * np.pi * m * 37.0 * TIME_S)[:, None] for m in (1, 2, 3, 4, -1, -2, -3)
    )
    survey = surveyed(room(blades), own_plan)
    assert "tag" not in {source.kind for source in survey.sources}
    assert adapted(own_plan, survey) is own_plan
    (finding,) = findings(survey, own_plan, own_plan)
    assert finding.kind == "clutter" and not finding.matters
    assert finding.frequency_hz == pytest.approx(148, abs=10)


def test_lamps_and_tags_are_no_motion(own_plan):
    """Aliased lines near zero would widen the clutter band for nothing."""
    still = surveyed(room(lamps(50, 8.0), 2 * square(1730.0, 2)), own_plan)
    assert still.moving_hz() == 0
    moving = surveyed(room(lamps(50, 8.0), walker(120.0)), own_plan)
    assert moving.moving_hz() == pytest.approx(120, abs=2 * moving.resolution_hz)


def test_short_survey_takes_no_second_line_for_a_clock(own_plan):
    """A tag at twice the true clock would be solved for, and half the lines not."""
    channel = room(lamps(50, 5.0), 2 * square(1730.0, 2))[:4096]
    tags = [each for each in surveyed(channel, own_plan).sources if each.kind == "tag"]
    assert [tag.fundamental_hz for tag in tags] == [pytest.approx(1730, abs=0.3)]


def test_clutter_wider_than_planned_widens_the_band(own_plan):
    """What the weights do not reject makes readings wrong."""
    short = replace(own_plan, clutter_hz=30.0)
    survey = surveyed(room(walker(80.0)), own_plan)
    wider = adapted(short, survey)
    assert wider.clutter_hz > 80
    (finding,) = [each for each in findings(survey, short, wider) if each.kind == "clutter"]
    assert finding.matters and f"up to {wider.clutter_hz:.0f} Hz (30 Hz" in finding.handling
    # A band that the scene states is kept.
    stated = settings(moving_clutter_hz=30.0)
    assert adapted(stated, survey).clutter_hz == stated.clutter_hz == 30


def test_unusable_channel_gives_no_survey():
    """A recording that cannot be surveyed is still read, with the scene's own plan."""
    known = [TagClock(1040.0)], (50.0, 60.0)
    assert survey_channel(room()[:1000], WAVEFORM, *known) is None  # less than 0.1 s
    for value in (np.nan, np.inf):
        bad = room()
        bad[5000, 3] = value
        assert survey_channel(bad, WAVEFORM, *known) is None
    assert survey_channel(np.ones((COUNT, CARRIERS)), WAVEFORM, *known) is None  # no noise
    silent = room()
    silent[:, 5] = 0
    assert survey_channel(silent, WAVEFORM, *known) is None


# Noise of a room in the weights.

LINES = np.array([1100.0, 1655.0, 3300.0])
POWER = np.array([2.0, 0.5, 4.0])


def covariance(length, mask=slice(None)):
    """White noise and a random phase at each of the lines, by definition."""
    turns = 2 * np.pi * np.outer(T * np.arange(length)[mask], LINES)
    waves = np.concatenate([np.exp(1j * turns), np.exp(-1j * turns)], axis=1)
    full = (waves * np.r_[POWER, POWER]) @ waves.conj().T
    return np.eye(len(full)) + full.real


def generalised(basis, cov, tones):
    """Rows of (B^H C^-1 B)^-1 B^H C^-1."""
    weighted = np.linalg.solve(cov, basis)
    return np.linalg.solve(basis.conj().T @ weighted, weighted.conj().T)[:tones]


@pytest.fixture(scope="module")
def disturbed():
    noise = RoomNoise(LINES, POWER, 400, T)
    return noise, design_weights([1040.0], 400, T, 100.0, room=noise)


def test_weights_equal_generalised_least_squares(disturbed):
    """Other weights would let more of the room through than necessary."""
    _, table = disturbed
    expected = generalised(table.basis, covariance(400), len(table.tones))
    assert np.abs(table.weights - expected).max() < 1e-6 * np.abs(expected).max() + 1e-7
    mask = np.arange(400) % 7 != 0
    partial = table.for_present(mask)
    expected = generalised(table.basis[mask], covariance(400, mask), len(table.tones))
    assert np.abs(partial.weights - expected).max() < 1e-6 * np.abs(expected).max() + 1e-7


def test_whitened_tones_have_unit_variance_in_that_room(disturbed):
    """Standard deviations of readings are those of whitened tones."""
    _, table = disturbed
    rng = np.random.default_rng(11)
    factor = np.linalg.cholesky(covariance(400))
    trials = 4000
    tones = table.whitener @ (table.parts @ (factor @ normal(rng, 400, trials)))
    power = np.mean(np.abs(tones) ** 2, axis=1)
    # Mean of 4000 exponentials: standard deviation 1.6 %.
    assert power == pytest.approx(np.ones(len(power)), abs=5 / np.sqrt(trials))
    correlation = tones @ tones.conj().T / trials - np.diag(power)
    assert np.abs(correlation).max() < 6 / np.sqrt(trials)


def test_noise_of_tones_equals_that_of_covariance():
    table = design_weights([1040.0], 400, T, 100.0)
    expected = np.einsum("mn,nk,mk->m", table.weights, covariance(400), table.weights.conj()).real
    expected = expected / np.sum(np.abs(table.weights) ** 2, axis=1) - 1
    whole = room_noise_of_tones(table, RoomNoise(LINES, POWER, 400, T))
    assert whole == pytest.approx(expected, rel=1e-6)


def test_power_of_lamps_counts_once_per_subcarrier(own_plan):
    """A reading averages white noise over the subcarriers, but not what arrives by one path."""
    line = 4 * np.cos(2 * np.pi * 1300 * TIME_S)[:, None]
    for part, weight in ((line, 1), (lamps(50.0, 4.0), CARRIERS)):
        survey = surveyed(room(part), own_plan)
        lines = [line for source in survey.sources for line in (*source.lines, *source.masked)]
        # A line of amplitude a has a power of a^2 / 2 in all.
        power = sum(2 * line.power for line in lines if line.frequency_hz > own_plan.clutter_hz)
        noise = survey.noise(own_plan.group_length, own_plan.clutter_hz)
        assert noise.autocovariance[0] - 1 == pytest.approx(weight * power, rel=0.1)


@pytest.mark.parametrize("clock_hz, counts", [(1040, CARRIERS), (1000, 1), (1050, 1)])
def test_lamps_on_lines_of_a_tag_count_once(own_plan, clock_hz, counts):
    """Weights that rely on lines whose lamps the noise hides err by more than they state."""
    planned = replace(own_plan, clocks=(TagClock(clock_hz),))
    survey = surveyed(room(lamps(50, 4.0)), planned)
    (source,) = [source for source in survey.sources if source.kind == "lamps"]
    assert survey.weight(source, 625) == counts
    assert expecting_snr(planned, survey).in_lamps == (counts == 1,)


def test_room_that_leaves_no_line_is_suppressed_less(own_plan, monkeypatch):
    """Nothing would be suppressed otherwise, although every reading is flagged."""
    survey = surveyed(room(lamps(50.0, 4.0)), own_plan)
    noise = survey.noise(own_plan.group_length, own_plan.clutter_hz).autocovariance
    weak = property(lambda plan: plan.room is None or plan.room.autocovariance[0] < noise[0] / 2)
    monkeypatch.setattr(Plan, "separable", weak)
    single = survey.noise(own_plan.group_length, own_plan.clutter_hz, averaged=False)
    assert single.autocovariance[0] < noise[0] / 2
    assert np.array_equal(adapted(own_plan, survey).room.autocovariance, single.autocovariance)


def test_adapted_settings_whose_lines_do_not_separate_are_not_used(own_plan, monkeypatch):
    """The weights could not be designed, and a room that is read worse would not be read at all."""
    short = replace(own_plan, clutter_hz=30.0)
    survey = surveyed(room(walker(80.0), 1.5 * square(1300.04, 3)), own_plan)
    better = adapted(short, survey)
    assert better.clutter_hz > 30 and better.others
    monkeypatch.setattr(Plan, "separable", property(lambda _: False))
    assert adapted(short, survey) is short
