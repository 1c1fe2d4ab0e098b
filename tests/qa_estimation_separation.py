# SPDX-License-Identifier: GPL-3.0-or-later
"""Separation of the ends at the tracked clock, and what it says of a group."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.separation import EndSeparator
from gnuradio.wiforce.estimation.tracked_tag import TagClock
from gnuradio.wiforce.signal.weights import design_weights
from plain import (
    TA,
    WAVEFORM,
    T,
    averaged_switches,
    bound_of,
    errors_deg,
    make_air,
    make_plan,
    random_tag,
    run_chain,
    turned_deg,
)
from wiforce_app.bench.air import TagOnAir

BINS = WAVEFORM.bins


def make_separator(clocks_hz=(1000.0,), clutter_hz=0.0, group_length=625):
    table = design_weights(clocks_hz, group_length, T, clutter_hz)
    return EndSeparator(table, [TagClock(f) for f in clocks_hz], TA, BINS)


def padded(tones):
    """Values of the occupied subcarriers among 64 bins."""
    bins = np.zeros((len(tones), 64), complex)
    bins[:, BINS] = tones
    return bins


def tones_of(separator, snapshots):
    with np.errstate(invalid="ignore"):
        return padded(separator.table.weights @ snapshots)


def separate(separator, air, groups, **how):
    """(GroupState, V) of all groups."""
    results = []
    for g in range(groups):
        results += separator.process(g, tones_of(separator, air.group(g, **how)))
    return results + separator.flush()


def loss_db(errors, bound):
    return 10 * np.log10(np.mean((errors / bound) ** 2, axis=0))


def test_ends_are_the_least_squares_solution_with_counted_waveforms():
    """On every subcarrier: tones = W [s1, s2] D, the tones' own noise whitened."""
    tag = TagOnAir(offset_ppm=-60.0, start_cycles=0.3, untouched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 1, 30.0)
    separator = make_separator()
    results, tones = [], []
    for g in range(12):
        tones.append(tones_of(separator, air.group(g))[:, BINS])
        results += separator.process(g, padded(tones[-1]))
    state, vectors = results[-1]
    weights = separator.table.weights
    clock = state.clocks[0]
    cycles_per_s = 1000.0 * (1 + clock.offset_ppm * 1e-6)
    cycles = clock.phase / (2 * np.pi) + cycles_per_s * separator.table.times_s
    waves = averaged_switches(cycles, cycles_per_s * TA, points=20001)
    white = np.linalg.inv(np.linalg.cholesky(weights @ weights.conj().T))
    expected = np.linalg.lstsq(white @ weights @ waves, white @ tones[-1], rcond=None)[0]
    # Counting errs by 1e-4 per snapshot, 625 of which are averaged.
    assert np.max(np.abs(vectors[:, BINS] - expected)) < 1e-3


def test_ends_come_out_as_the_channels_that_were_put_in():
    tag = TagOnAir(offset_ppm=90.0, start_cycles=0.8, untouched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 2, 60.0, static_db=70)
    vectors = separate(make_separator(), air, 12)[-1][1][:, BINS]
    # Noise of an end is -60 dB - 20 dB; the common clock error drops out of the ends' phases.
    assert np.max(np.abs(vectors - air.ends(False))) < 2e-3
    unused = np.setdiff1d(np.arange(64), BINS)
    assert np.all(separate(make_separator(), air, 12)[0][1][:, unused] == 0)


def test_stated_noise_gain_and_snr_are_those_seen():
    tag = TagOnAir(offset_ppm=20.0, start_cycles=0.1, untouched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 3, 5.0)
    results = separate(make_separator(), air, 80)
    errors = np.array([vectors[:, BINS] - air.ends(False) for _, vectors in results[11:]])
    seen = np.mean(np.abs(errors) ** 2, axis=(0, 2))
    stated = np.mean([state.gain for state, _ in results[11:]], axis=0) * air.noise[0]
    # 69 groups of 62 subcarriers; the clock's jitter adds some per cent.
    assert stated == pytest.approx(seen, rel=0.12)
    noise = np.mean([state.noise for state, _ in results], axis=0)
    assert noise.mean() == pytest.approx(air.noise[0], rel=0.03)
    # By definition: |c1[1] G|^2 against the noise in H; 12.95 dB below gamma, averaging included.
    snr = np.mean([state.snr_db for state, _ in results], axis=0)
    assert snr == pytest.approx([5 - 12.96] * 2, abs=0.3)


@pytest.mark.parametrize(
    "gamma_db, clutter_hz, around",
    [(-15, 0.0, {}), (10, 0.0, {"static_db": 70}), (0, 250.0, {"static_db": 70, "movers_db": 30})],
)
def test_errors_stay_near_the_bound(gamma_db, clutter_hz, around):
    """Off clock, drift, fading, static and moving clutter together."""
    plan, ratios = make_plan(clutter_hz=clutter_hz), []
    for seed in range(2):
        tags = [random_tag(np.random.default_rng([4, seed]))]
        air = make_air(625, tags, [5, seed], gamma_db, **around)
        errors = errors_deg(run_chain(plan, air, 87), tags)
        ratios.append(errors / bound_of(air, clutter_hz=clutter_hz))
    # 150 errors know the loss, .3 dB or so, to 1 dB.
    assert np.max(loss_db(np.concatenate(ratios), 1.0)) < 1.5


@pytest.mark.parametrize("lost", ["at random", "in a block"])
def test_a_fifth_of_the_snapshots_missing_costs_no_more_than_they_held(lost):
    plan, rng, ratios = make_plan(), np.random.default_rng(6), []
    masks = rng.random((87, 625)) > 0.2
    if lost == "in a block":
        masks = [np.roll(np.arange(625) >= 125, shift) for shift in rng.integers(625, size=87)]
    for seed in range(2):
        tags = [random_tag(np.random.default_rng([7, seed]))]
        air = make_air(625, tags, [8, seed], 0.0, static_db=70)
        results = run_chain(plan, air, 87, present=lambda g: masks[g])
        assert all(state.missing == np.sum(~masks[state.group]) for state, _ in results)
        ratios.append(errors_deg(results, tags) / bound_of(air, mask=masks[20]))
    assert np.max(loss_db(np.concatenate(ratios), 1.0)) < 1.5


def test_a_group_of_which_little_is_left_is_given_up_not_guessed():
    tag = TagOnAir(untouched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 9, 20.0)
    keep = np.arange(625) < 12
    results = run_chain(make_plan(), air, 20, present=lambda g: keep if g == 15 else keep >= 0)
    state, ratios = results[15]
    assert not state.clocks[0].locked and np.all(np.isinf(state.std_deg)) and np.all(ratios == 0)
    assert state.missing == 613 and results[16][0].clocks[0].locked


def test_two_tags_are_read_together():
    """1.0 and 1.4 kHz share a line, and 36 ms are no whole periods of 1.4 kHz."""
    plan, ratios = make_plan((1000.0, 1400.0)), []
    for seed in range(2):
        rng = np.random.default_rng([10, seed])
        tags = [random_tag(rng), random_tag(rng, clock_hz=1400.0)]
        air = make_air(625, tags, [11, seed], 0.0)
        ratios.append(errors_deg(run_chain(plan, air, 87), tags) / bound_of(air))
    assert np.max(loss_db(np.concatenate(ratios), 1.0)) < 1.5


@pytest.mark.parametrize("second_db, largest_deg", [(0.0, 0.01), (-20.0, 0.1)])
def test_one_tag_does_not_bias_the_other(second_db, largest_deg):
    plan = make_plan((1000.0, 1400.0))
    for seed in range(3):
        rng = np.random.default_rng([12, seed])
        tags = [random_tag(rng), random_tag(rng, clock_hz=1400.0, level_db=second_db)]
        air = make_air(625, tags, [13, seed], 60.0)
        bias = np.mean(errors_deg(run_chain(plan, air, 40), tags), axis=0)
        assert np.max(np.abs(bias)) < largest_deg


def test_second_clock_of_2_khz_minus_a_little_is_never_read_with_confidence():
    """Its lines lie on those of the first: what comes out must not look certain and be wrong."""
    plan = make_plan((1000.0, 1995.0))
    rng = np.random.default_rng(14)
    tags = [random_tag(rng), random_tag(rng, clock_hz=1995.0)]
    results = run_chain(plan, make_air(625, tags, 15, 10.0), 60)
    errors = errors_deg(results, tags)
    stated = np.array([state.std_deg for state, _ in results if state.group >= 12])
    assert np.mean(np.abs(errors) < 3 * stated + 0.5) > 0.9


@pytest.mark.parametrize("broken", [np.nan, np.inf, 0.0])
def test_a_group_that_is_not_finite_or_empty_gives_nothing_and_harms_nothing(broken):
    tag = TagOnAir(untouched_deg=(35.0, -80.0), touched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 16, 20.0)
    separator, results = make_separator(), []
    for g in range(30):
        snapshots = air.group(g)
        if g in (3, 20):
            snapshots[100 if broken else slice(None)] = broken
        results += separator.process(g, tones_of(separator, snapshots))
    for g, (state, vectors) in enumerate(results):
        assert state.clocks[0].locked == (g not in (3, 20))
        assert np.all(np.isfinite(vectors)) and np.all(np.isfinite(state.noise))
        assert np.all(np.isinf(state.gain)) == (g in (3, 20))


def test_nothing_at_all_gives_groups_without_ends():
    separator = make_separator()
    results = []
    for g in range(30):
        results += separator.process(g, np.zeros((16, 64)))
    assert len(results) == 30
    for state, vectors in results:
        assert not state.clocks[0].locked and np.all(np.isinf(state.gain)) and not vectors.any()


def test_a_tag_that_is_off_is_not_read():
    air = make_air(625, [TagOnAir()], 17, 10.0, static_db=60, movers_db=20)
    results = separate(make_separator(clutter_hz=250.0), air, 60, on=False)
    assert len(results) == 60
    assert not any(state.clocks[0].locked for state, _ in results)


def test_a_tag_switched_on_again_is_found_and_its_reference_holds():
    """Its clock starts anew at any phase: the two ends must not turn with it."""
    tags = [TagOnAir(start_cycles=0.2, untouched_deg=(35.0, -80.0), touched_deg=(95.0, -20.0))]
    air = make_air(625, tags, 18, 10.0)

    def on(group):
        if group == 30:
            air.clocks[0]._cycles += 0.3719
        return not 15 <= group < 40

    results = run_chain(make_plan(), air, 70, on=on)
    locked = np.array([state.clocks[0].locked for state, _ in results])
    assert locked[:15].all() and not locked[15:40].any()
    back = int(np.argmax(locked[40:])) + 40
    assert back - 40 <= 12 and locked[back:].all()
    errors = errors_deg(results, tags)
    assert np.max(np.abs(errors[back - 12 :])) < 1.0


def test_a_tag_that_comes_later_than_the_first_is_found():
    tags = [TagOnAir(untouched_deg=(35.0, -80.0)), TagOnAir(1400.0, untouched_deg=(5.0, 80.0))]
    air = make_air(625, tags, 19, 10.0)
    separator, results = make_separator((1000.0, 1400.0)), []
    for g in range(60):
        snapshots = air.group(g, on=(True, g >= 25))
        results += separator.process(g, tones_of(separator, snapshots))
    locked = np.array([[clock.locked for clock in state.clocks] for state, _ in results])
    assert locked[:, 0].all() and not locked[:25, 1].any() and locked[40:, 1].all()


def test_one_loud_group_does_not_hide_the_tag_in_those_around_it():
    tag = TagOnAir(offset_ppm=30.0, start_cycles=0.1, untouched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 9, 5.0)
    rng, separator, results = np.random.default_rng(10), make_separator(), []
    for g in range(24):
        snapshots = air.group(g)
        if g == 5:
            snapshots = snapshots + 300 * rng.standard_normal(snapshots.shape)
        results += separator.process(g, tones_of(separator, snapshots))
    assert all(state.clocks[0].locked for state, _ in results)
    # What it did to the usual noise is gone after some groups.
    assert results[0][0].noise.mean() == pytest.approx(air.noise[0], rel=0.1)


def test_an_interferer_on_12_of_64_subcarriers_is_weighted_out():
    """Without the weights it would cost 13 dB."""
    profile = np.ones(62)
    profile[10:22] = 100.0
    plan, ratios, plain_errors = make_plan(), [], []
    for seed in range(2):
        tags = [random_tag(np.random.default_rng([20, seed]))]
        air = make_air(625, tags, [21, seed], 0.0, profile)
        errors = errors_deg(run_chain(plan, air, 87), tags)
        ratios.append(errors / bound_of(air))
        plain_errors.append(errors)
    assert np.max(loss_db(np.concatenate(ratios), 1.0)) < 1.7
    assert np.sqrt(np.mean(np.concatenate(plain_errors) ** 2)) < 0.9


def test_a_delay_of_clock_2_does_not_turn_end_2():
    """31 us left out would turn it by a degree when the touch changes the shared lines."""
    tags = [
        TagOnAir(
            untouched_deg=(0.0, 0.0),
            touched_deg=(90.0, -60.0),
            clock2_delay_cycles=0.031,
            start_cycles=0.3,
            offset_ppm=30.0,
        )
    ]
    results = run_chain(make_plan(), make_air(625, tags, 22, 30.0), 60)
    assert np.max(np.abs(np.mean(errors_deg(results, tags), axis=0))) < 0.02
    assert results[-1][0].clocks[0].clock2_delay == pytest.approx(2 * np.pi * 0.031, abs=0.01)


def test_overlapping_pulses_are_reported():
    tags = [random_tag(np.random.default_rng(23), clock2_delay_cycles=0.25)]
    results = run_chain(make_plan(), make_air(625, tags, 24, 0.0), 20)
    assert all(state.clocks[0].overlapping for state, _ in results)
    tags = [random_tag(np.random.default_rng(23))]
    results = run_chain(make_plan(), make_air(625, tags, 24, 0.0), 20)
    assert not any(state.clocks[0].overlapping for state, _ in results)


def test_a_press_inside_a_group_makes_it_uncertain():
    """The phases jump in the middle: the group fits no constant ends, and must say so."""
    tag = TagOnAir(untouched_deg=(0.0, 0.0), touched_deg=(120.0, 90.0))
    air = make_air(625, [tag], 25, 20.0)
    separator, results = make_separator(), []
    for g in range(20):
        share = (np.arange(625) > 300) if g == 15 else g > 15
        results += separator.process(g, tones_of(separator, air.group(g, share)))
    gains = np.array([state.gain for state, _ in results])
    assert np.all(gains[15] > 3 * gains[14])
    assert np.all(gains[16:] < 1.3 * gains[14])


@pytest.mark.parametrize("turn_cycles", [0.1, 0.5, -0.3])
def test_a_clock_that_jumped_is_found_anew_and_doubted_until_then(turn_cycles):
    before, after = (
        make_air(625, [TagOnAir(start_cycles=start, untouched_deg=(35.0, -80.0))], 23, 10.0)
        for start in (0.2, 0.2 + turn_cycles)
    )
    separator, results = make_separator(), []
    for g in range(44):
        results += separator.process(g, tones_of(separator, (before, after)[g >= 30].group(g)))
    gains = np.array([state.gain for state, _ in results])
    vectors = np.array([v[:, WAVEFORM.bins] for _, v in results])
    assert np.all(gains[30:37] > 3 * gains[20])
    # Eight groups, of which none was as before.
    assert np.all(gains[38:] < 1.3 * gains[20])
    turned = np.angle(np.sum(vectors[38:] * vectors[20].conj(), axis=2))
    assert np.abs(np.degrees(turned)).max() < 2.0


@pytest.mark.parametrize("change_db", [6.0, -6.0])
def test_a_new_noise_level_is_stated_within_half_a_second(change_db):
    tag = TagOnAir(offset_ppm=20.0, start_cycles=0.1, untouched_deg=(35.0, -80.0))
    before, after = (make_air(625, [tag], 21, gamma) for gamma in (10.0, 10.0 - change_db))
    separator = make_separator()
    for g in range(40):
        separator.process(g, tones_of(separator, before.group(g)))
    results = []
    for g in range(40, 54):
        results += separator.process(g, tones_of(separator, after.group(g)))
    stated_db = 10 * np.log10(np.mean(results[-1][0].noise) / before.noise[0])
    # 8 groups of 868 degrees of freedom tell it to 4 %, whose median to 5 %.
    assert stated_db == pytest.approx(change_db, abs=0.5)


def test_a_press_that_takes_two_thirds_of_a_leaky_tags_energy_is_still_that_tag():
    # |G - G_off| goes from 1.3 to .7.
    tag = TagOnAir(offset_ppm=40.0, untouched_deg=(180.0, 180.0), off_reflection=0.3)
    air = make_air(625, [tag], 22, 20.0)
    separator = make_separator()
    results = []
    for g in range(60):
        results += separator.process(g, tones_of(separator, air.group(g, touched=g >= 30)))
    assert [state.clocks[0].locked for state, _ in results] == [True] * 60


def test_bins_that_nobody_sends_on_are_never_read():
    air = make_air(625, [TagOnAir(untouched_deg=(35.0, -80.0))], 26, 20.0)
    separator = make_separator()
    tones = [tones_of(separator, air.group(g)) for g in range(12)]
    for t in tones:
        t[:, np.setdiff1d(np.arange(64), BINS)] = np.nan
    results = [r for g, t in enumerate(tones) for r in separator.process(g, t)]
    assert all(state.clocks[0].locked for state, _ in results)


def test_touched_groups_keep_their_magnitude():
    """|R| tells a free sensor from one whose press changed inside the group."""
    tags = [TagOnAir(untouched_deg=(10.0, 20.0), touched_deg=(100.0, -70.0))]
    results = run_chain(make_plan(), make_air(625, tags, 27, 0.0), 100)
    magnitudes = np.abs([ratios for state, ratios in results if state.group >= 12])
    assert magnitudes.mean(axis=0) == pytest.approx([1.0, 1.0], abs=0.01)
    assert turned_deg(tags) == pytest.approx([90.0, -90.0])
