# SPDX-License-Identifier: GPL-3.0-or-later
"""Separation of the ends at the tracked clock, and what it says of a group."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.estimation.ends.separation import EndSeparator
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.signal.weights import design_weights
from plain import (
    WAVEFORM,
    T,
    errors_deg,
    make_air,
    make_plan,
    random_tag,
    run_chain,
)
from wiforce_app.bench.air import TagOnAir


def separate(snapshots, clutter_hz=0.0):
    """Groups of a tag at 1 kHz with their ends, of snapshots (N, K) given group by group."""
    table = design_weights((1000.0,), 625, T, clutter_hz)
    stage, ready = EndSeparator(table, [TagClock(1000.0)], WAVEFORM, derotated=False), []
    with np.errstate(invalid="ignore"):
        for group, own in enumerate(snapshots):
            ready.append(stage.process(Groups([group], (table.weights @ own)[None])))
    return Groups.concatenate([*ready, stage.flush()])


def test_separation_stated_noise_gain_and_snr_match_the_errors():
    tag = TagOnAir(offset_ppm=20.0, start_cycles=0.1, untouched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 3, 5.0)
    results = separate(map(air.group, range(80)))
    errors = results.ends[11:] - air.ends(False)
    seen = np.mean(np.abs(errors) ** 2, axis=(0, 2))
    stated = np.mean(results.gain[11:], axis=0) * air.noise[0]
    # 69 groups of 62 subcarriers; the clock's jitter adds some per cent.
    assert stated == pytest.approx(seen, rel=0.12)
    assert results.noise.mean() == pytest.approx(air.noise[0], rel=0.03)
    # By definition: |c1[1] G|^2 against the noise in H; 12.95 dB below gamma, averaging included.
    assert np.mean(results.snr_db, axis=0) == pytest.approx([5 - 12.96] * 2, abs=0.3)


@pytest.mark.parametrize(
    "gamma_db, clutter_hz, around, others_hz, lost",
    [
        (-15, 0.0, {}, (), None),
        (10, 0.0, {"static_db": 70}, (), None),
        (0, 250.0, {"static_db": 70, "movers_db": 30}, (), None),
        # Interference on 12 subcarriers would cost 13 dB without the weights.
        (0, 0.0, {"noise_profile": np.repeat([1.0, 100.0, 1.0], [10, 12, 40])}, (), None),
        # 1.0 and 1.4 kHz share a line, and 36 ms are no whole periods of 1.4 kHz.
        (0, 0.0, {}, (1400.0,), None),
        (0, 0.0, {"static_db": 70}, (), "at random"),
        (0, 0.0, {"static_db": 70}, (), "in a block"),
    ],
)
def test_phases_stay_near_the_bound(gamma_db, clutter_hz, around, others_hz, lost):
    """Off clock, drift, fading, static and moving clutter, or a fifth of the snapshots missing."""
    plan, ratios = make_plan((1000.0, *others_hz), clutter_hz=clutter_hz), []
    rng, masks = np.random.default_rng(6), np.ones((87, 625), bool)
    if lost == "at random":
        masks = rng.random((87, 625)) > 0.2
    elif lost:
        masks = [np.roll(np.arange(625) >= 125, shift) for shift in rng.integers(625, size=87)]
    for seed in range(2):
        rng = np.random.default_rng([4, seed])
        tags = [random_tag(rng), *(random_tag(rng, clock_hz=hertz) for hertz in others_hz)]
        air = make_air(625, tags, [5, seed], gamma_db, **around)
        results = run_chain(plan, air, 87, present=lambda g: masks[g])
        assert results.missing.tolist() == [np.sum(~masks[g]) for g in results.index]
        bound = air.bound_deg(reference_groups=12, clutter_hz=clutter_hz, mask=masks[20])
        ratios.append(errors_deg(results, tags) / bound)
    # 150 errors know the loss, .3 dB or so, to 1 dB.
    excess = np.mean(np.concatenate(ratios) ** 2, axis=0)
    assert np.max(10 * np.log10(excess)) < 1.5


def test_separation_group_with_few_snapshots_is_discarded():
    tag = TagOnAir(untouched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 9, 20.0)
    keep = np.arange(625) < 12
    results = run_chain(make_plan(), air, 20, present=lambda g: keep if g == 15 else keep >= 0)
    assert not results.locked[15, 0] and np.all(np.isinf(results.phase_std_deg[15]))
    assert np.all(results.ratios[15] == 0)
    assert results.missing[15] == 613 and results.locked[16, 0]


@pytest.mark.parametrize("second_db, largest_deg", [(0.0, 0.01), (-20.0, 0.1)])
def test_phases_beside_a_second_tag_are_unbiased(second_db, largest_deg):
    plan = make_plan((1000.0, 1400.0))
    for seed in range(3):
        rng = np.random.default_rng([12, seed])
        tags = [random_tag(rng), random_tag(rng, clock_hz=1400.0, level_db=second_db)]
        air = make_air(625, tags, [13, seed], 60.0)
        bias = np.mean(errors_deg(run_chain(plan, air, 40), tags), axis=0)
        assert np.max(np.abs(bias)) < largest_deg


@pytest.mark.parametrize("broken", [np.nan, np.inf, 0.0])
def test_separation_invalid_group_is_empty_and_affects_no_other(broken):
    tag = TagOnAir(untouched_deg=(35.0, -80.0), touched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 16, 20.0)
    snapshots = [air.group(g) for g in range(30)]
    for g in (3, 20):
        snapshots[g][100 if broken else slice(None)] = broken
    results = separate(snapshots)
    hurt = np.isin(np.arange(30), (3, 20))
    assert np.array_equal(results.locked[:, 0], ~hurt)
    assert np.all(np.isfinite(results.ends)) and np.all(np.isfinite(results.noise))
    assert np.array_equal(np.all(np.isinf(results.gain), axis=1), hurt)


def test_separation_tag_switched_off_is_not_locked():
    air = make_air(625, [TagOnAir()], 17, 10.0, static_db=60, movers_db=20)
    results = separate((air.group(g, on=False) for g in range(60)), 250.0)
    assert len(results) == 60
    assert not results.locked.any()


def test_separation_tag_silent_in_a_group_of_the_acquisition_is_no_part_of_the_reference():
    """Else noise is the first thing that is known of the sensor, and its presses are unreadable."""
    air = make_air(625, [TagOnAir(start_cycles=0.2, untouched_deg=(35.0, -80.0))], 19, 10.0)
    silent = np.isin(np.arange(16), (0, 4))
    results = run_chain(make_plan(), air, 16, on=lambda group: not silent[group])
    assert np.array_equal(results.locked[:, 0], ~silent)
    assert np.array_equal(results.in_reference[:12, 0], ~silent[:12])
    assert np.abs(results.ratios[1]) == pytest.approx([1, 1], abs=0.01)


def test_separation_tag_switched_on_again_is_acquired_and_keeps_its_reference():
    """Its clock starts anew at any phase: the two ends must not turn with it."""
    tags = [TagOnAir(start_cycles=0.2, untouched_deg=(35.0, -80.0), touched_deg=(95.0, -20.0))]
    air = make_air(625, tags, 18, 10.0)

    def on(group):
        if group == 30:
            air.clocks[0]._start_cycles += 0.3719
        return not 15 <= group < 40

    results = run_chain(make_plan(), air, 70, on=on)
    locked = results.locked[:, 0]
    assert locked[:15].all() and not locked[15:40].any()
    back = int(np.argmax(locked[40:])) + 40
    assert back - 40 <= 12 and locked[back:].all()
    errors = errors_deg(results, tags)
    assert np.max(np.abs(errors[back - 12 :])) < 1.0


def test_separation_loud_group_does_not_hide_the_tag_in_others():
    tag = TagOnAir(offset_ppm=30.0, start_cycles=0.1, untouched_deg=(35.0, -80.0))
    air = make_air(625, [tag], 9, 5.0)
    snapshots = [air.group(g) for g in range(24)]
    snapshots[5] = snapshots[5] + 300 * np.random.default_rng(10).standard_normal((625, 62))
    results = separate(snapshots)
    assert results.locked.all()
    # What it did to the usual noise is gone after some groups.
    assert results.noise[0].mean() == pytest.approx(air.noise[0], rel=0.1)


def test_separation_press_inside_a_group_raises_its_gain():
    """The phases jump in the middle: the group fits no constant ends, and must say so."""
    tag = TagOnAir(untouched_deg=(0.0, 0.0), touched_deg=(120.0, 90.0))
    air = make_air(625, [tag], 25, 20.0)
    inside = np.arange(625) > 300
    gains = separate(air.group(g, inside if g == 15 else g > 15) for g in range(20)).gain
    assert np.all(gains[15] > 3 * gains[14])
    assert np.all(gains[16:] < 1.3 * gains[14])


@pytest.mark.parametrize("turn_cycles", [0.1, 0.5, -0.3])
def test_separation_clock_jump_raises_the_gain_until_reacquired(turn_cycles):
    before, after = (
        make_air(625, [TagOnAir(start_cycles=start, untouched_deg=(35.0, -80.0))], 23, 10.0)
        for start in (0.2, 0.2 + turn_cycles)
    )
    results = separate((before, after)[g >= 30].group(g) for g in range(44))
    gains, ends = results.gain, results.ends
    assert np.all(gains[30:37] > 3 * gains[20])
    # Eight groups, of which none was as before.
    assert np.all(gains[38:] < 1.3 * gains[20])
    turned = np.angle(np.sum(ends[38:] * ends[20].conj(), axis=2))
    assert np.abs(np.degrees(turned)).max() < 2.0


@pytest.mark.parametrize("change_db", [6.0, -6.0])
def test_separation_noise_step_is_stated_within_half_a_second(change_db):
    tag = TagOnAir(offset_ppm=20.0, start_cycles=0.1, untouched_deg=(35.0, -80.0))
    before, after = (make_air(625, [tag], 21, gamma) for gamma in (10.0, 10.0 - change_db))
    results = separate((before, after)[g >= 40].group(g) for g in range(54))
    stated_db = 10 * np.log10(np.mean(results.noise[-1]) / before.noise[0])
    # 8 groups of 868 degrees of freedom tell it to 4 %, whose median to 5 %.
    assert stated_db == pytest.approx(change_db, abs=0.5)
