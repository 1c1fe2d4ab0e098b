# SPDX-License-Identifier: GPL-3.0-or-later
"""The press filter against plain computations, and what it makes of single events."""

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.press.explanations import (
    MIXED,
    PRESSED,
    UNEXPLAINED,
    UNTOUCHED,
    filter_of,
    later,
)
from gnuradio.wiforce.wiforce_kernels import press_observation
from long_cases import cases

PERIOD_S, NOISE_DEG, SMOOTHING_S = 0.0072, 0.2, 0.036
MODEL = wiforce.load_sensor("line-900mhz")
PRESS = np.asarray(MODEL.phases_deg(4.0, 30.0)) - MODEL.untouched_deg()
MIDDLE = np.asarray(MODEL.phases_deg(4.0, 40.0)) - MODEL.untouched_deg()


def ratios_of(found):
    """R, averaged over the groups for as long as nothing has changed; complex, shape (m, 2)."""
    mean = found["mean"]
    return np.exp(mean["amplitude"] + 1j * mean["phase"])


def probability(found, which, groups):
    """Sum of the weights of some outcomes, by mask (m,), in each group; shape (G,)."""
    return np.bincount(found["row"], found["weight"] * which, minlength=groups)[:groups]


def likeliest(found, groups):
    """Index of the likeliest outcome of each group, shape (G,)."""
    return np.searchsorted(found["row"], np.arange(groups))


def filter_for(off=0.0, period_s=PERIOD_S, **parameters):
    """The press filter of groups of this length."""
    return filter_of(MODEL, 900e6, off, period_s=period_s, **parameters)


def rows_of(phases_deg, receiver=None, noise_deg=NOISE_DEG, period_s=PERIOD_S, untouched=20):
    """What the kernel takes of groups with these phases (n, 2), without loss of amplitude."""
    rows = np.zeros(len(phases_deg), press_observation)
    rows["time_s"] = (np.arange(len(rows)) + 0.5) * period_s
    rows["phase"] = np.radians(phases_deg)
    rows["variance"] = np.radians(noise_deg) ** 2
    rows["receiver_variance"] = 1e-8
    if receiver is not None:
        rows["receiver_phase"] = np.radians(receiver)
    rows["untouched"][:untouched] = 0.999
    return rows


def phases_of(press_deg, untouched=60, pressed=60, released=60, noise_deg=NOISE_DEG, seed=1):
    """Phases in degrees, untouched, pressed and untouched again; with noise."""
    rng = np.random.default_rng(seed)
    level = np.zeros((untouched + pressed + released, 2))
    level[untouched : untouched + pressed] = press_deg
    return level + noise_deg * rng.standard_normal(level.shape)


def explained(rows, press_filter=None, **parameters):
    """What may have happened in each of the groups."""
    if press_filter is None:
        period_s = rows["time_s"][1] - rows["time_s"][0]
        press_filter = filter_for(period_s=period_s, **parameters)
    found = np.concatenate([press_filter.take(rows), later(press_filter.newest(), len(rows))])
    return later(found[found["row"] > 0], -1)


def share_of(state, rows, press_filter=None, **parameters):
    """Probability of a state in each of the groups; shape (G,)."""
    found = explained(rows, press_filter, **parameters)
    return probability(found, found["is"] == state, len(rows))


def state_of(found, group):
    """State of a group and its probability."""
    here = found[found["row"] == group]
    return int(here["is"][0]), float(here["weight"][here["is"] == here["is"][0]].sum())


def test_press_and_release_are_recognized_in_their_groups():
    found = explained(rows_of(phases_of(PRESS)))
    for group, state in ((50, UNTOUCHED), (60, PRESSED), (100, PRESSED), (121, UNTOUCHED)):
        assert state_of(found, group) == (state, pytest.approx(1, abs=0.01)), group


def test_phases_of_no_press_are_unexplained():
    found = explained(rows_of(phases_of((150.0, 150.0))))
    assert state_of(found, 100) == (UNEXPLAINED, pytest.approx(1, abs=0.01))


def test_average_is_the_recursion_over_groups_of_a_state():
    rng = np.random.default_rng(3)
    noise = rng.uniform(0.1, 0.4, (40, 2))
    phases = noise * rng.standard_normal(noise.shape)
    found = explained(rows_of(phases, noise_deg=noise), smoothing_s=SMOOTHING_S)
    x = PERIOD_S / SMOOTHING_S
    mean, variance, weight = np.zeros(2), np.zeros(2), np.zeros(2)
    for group in range(40):
        weight *= (1 - x) / (1 + x) if group else 0
        own = 1 / np.radians(noise[group]) ** 2
        gain = own / (own + weight)
        mean = mean + gain * (phases[group] - mean)
        variance = gain**2 / own + (1 - gain) ** 2 * variance
        weight = weight + own
        here = found[found["row"] == group]
        np.testing.assert_allclose(np.degrees(np.angle(ratios_of(here)[0])), mean, atol=1e-9)
        np.testing.assert_allclose(here["mean"]["variance"][0], variance, rtol=1e-9)


def test_average_begins_anew_with_a_press_and_follows_a_slow_one():
    phases = phases_of(PRESS, pressed=400)
    phases[60:460] += 0.25 * NOISE_DEG * np.arange(400)[:, None] * (0.3, 1)
    truth = PRESS + 0.25 * NOISE_DEG * np.arange(400)[:, None] * (0.3, 1)
    found = explained(rows_of(phases), smoothing_s=SMOOTHING_S)
    first = likeliest(found, len(phases))
    means = np.degrees(np.angle(ratios_of(found[first[60:460]]) * np.exp(-1j * np.radians(truth))))
    assert np.abs(means[0] - (phases[60] - truth[0])).max() < 1e-6
    std = np.degrees(np.sqrt(found["mean"]["variance"][first[60:460]]))
    assert np.mean(np.abs(means) < 2 * std) > 0.75
    assert np.sqrt(np.mean(means**2)) < 1.05 * NOISE_DEG


def test_press_and_untouched_line_follow_a_step_of_the_receiver():
    for turn in (0.5, 3.0, 40.0, -170.0):
        phases, receiver = phases_of(PRESS, pressed=100), np.zeros(220)
        phases[100:] += turn
        receiver[100] = turn
        found = explained(rows_of(phases, receiver))
        here = found[found["row"] == 120]
        assert state_of(found, 120) == (PRESSED, pytest.approx(1, abs=0.01))
        off = np.degrees(here["baseline"][0]) - turn
        assert np.abs((off + 180) % 360 - 180).max() < 0.5, turn


def test_turn_at_mid_line_is_decided_by_the_release():
    """The page of the press model says so: force and turn look alike until then."""
    phases = phases_of(MIDDLE, pressed=120)
    phases[100:] -= 8.0  # as of 2 N; of more force than any press, it would be a turn
    for turns, doubt in ((3e-4, (0.0, 0.5)), (3.0, (0.5, 1.0))):
        found = explained(rows_of(phases), turns=turns)
        turned = found["baseline"].mean(axis=1) < -np.radians(4)
        share = probability(found, turned & (found["is"] == PRESSED), 240)[150]
        assert doubt[0] <= share <= doubt[1], turns
        at_last = found[found["row"] == 230]
        assert at_last["is"][0] == UNTOUCHED
        assert np.degrees(at_last["baseline"][0]) == pytest.approx([-8, -8], abs=0.3)


@pytest.mark.parametrize("turn_deg", [3.0, -30.0])
def test_turn_at_mid_line_is_seen_where_off_states_differ(turn_deg):
    """Phases alone read it as a change of force."""
    off, untouched = np.array([0.3, -0.3]), np.exp(1j * np.radians(MODEL.untouched_deg()))
    ratio = (untouched * np.exp(1j * np.radians(MIDDLE)) - off) / (untouched - off)
    ratios = np.ones((200, 2), complex)
    ratios[60:140] = ratio
    ratios[100:] *= 1.05 * np.exp(1j * np.radians(turn_deg))
    rows = rows_of(phases_of((0.0, 0.0), 60, 80, 60) + np.degrees(np.angle(ratios)))
    rows["amplitude"] = np.log(np.abs(ratios))
    rows["amplitude"] += np.radians(NOISE_DEG) * np.random.default_rng(2).standard_normal((200, 2))
    found = explained(rows, filter_for(off))
    first = likeliest(found, 200)
    for group, turned in ((90, 0.0), (130, turn_deg), (190, turn_deg)):
        line = np.degrees(found["baseline"][first[group]].mean())
        assert line == pytest.approx(turned, abs=1.0), group


def rows_by_off_states(off, phases_deg, lost_np=0.0, **more):
    """Rows for groups of these phases (n, 2) with off states, and a loss at end 1 while pressed."""
    untouched, off = np.exp(1j * np.radians(MODEL.untouched_deg())), np.asarray(off)
    ratio = (untouched * np.exp(1j * np.radians(phases_deg)) - off) / (untouched - off)
    rows = rows_of(np.degrees(np.angle(ratio)), **more)
    rows["amplitude"] = np.log(np.abs(ratio))
    rows["amplitude"][60:120, 0] -= lost_np
    return rows


def test_slide_that_begins_while_the_tag_turns_leaves_the_turn_in_the_deviation():
    """Without it the turn ended with the begin of the slide, 12 to 18 deviations off."""
    off, count, noise_deg = (0.3, -0.3), 74, 0.08
    time = 0.036 * np.arange(count)
    slid, turn = np.clip((time - 58 * 0.036) / 0.44, 0, 1), 5.5 * np.clip(time - 50 * 0.036, 0, 1)
    phases = MODEL.phases_deg(4.9 - 2.5 * slid, 42.8 - 2.8 * slid) - MODEL.untouched_deg()
    phases[:30] = 0
    rows = rows_by_off_states(off, phases, noise_deg=noise_deg, period_s=0.036)
    noise = np.radians(noise_deg) * np.random.default_rng(1).standard_normal((2, count, 2))
    rows["phase"] += noise[0] + np.radians(turn)[:, None]
    rows["amplitude"] += noise[1]
    found = explained(rows, filter_for(off, 0.036, turns=0.25))
    found = found[(found["is"] == PRESSED) & (found["row"] < count - 1)]
    line, weights = (
        np.degrees(found["baseline"].mean(axis=1)),
        found["weight"] / probability(found, True, count)[found["row"]],
    )
    mean = np.bincount(found["row"], weights * line, minlength=count)
    square = np.degrees(1) ** 2 * found["common_variance"] + (line - mean[found["row"]]) ** 2
    std = np.sqrt(np.bincount(found["row"], weights * square, minlength=count))
    assert (np.abs(mean - turn)[32:-1] < 5 * std[32:-1]).all()


@pytest.mark.parametrize("off", cases((0, 0), (0.3j, -0.2), long=(((0.3, 0.3),), ((0.3, -0.3),))))
def test_claim_beside_a_press_leaves_both_possible_until_the_release(off):
    """It is held for a minute: hands and turns that do not come may not decide."""
    rows, press_filter = rows_by_off_states(off, phases_of(PRESS)), filter_for(off)
    explained(rows[:90], press_filter)
    press_filter.claim_untouched(0.5)
    period_s = rows["time_s"][1] - rows["time_s"][0]
    held = np.repeat(rows[90:91], round(60 / period_s))
    held["time_s"] += period_s * np.arange(len(held))
    held["phase"] += np.radians(0.05) * np.random.default_rng(1).standard_normal((len(held), 2))
    for part in np.array_split(held, 60):
        newest = press_filter.newest()
        # Some of what may have happened since is not compared.
        assert newest["weight"][newest["is"] == UNTOUCHED].sum() == pytest.approx(0.5, abs=0.1)
        explained(part, press_filter)
    rows["time_s"] += 60
    found = explained(rows[91:], press_filter)
    assert state_of(found, 85) == (UNTOUCHED, pytest.approx(1, abs=0.01))


@pytest.mark.parametrize("off", [(0, 0), (0.3, -0.3)])
def test_claim_inside_a_change_leaves_both_possible(off):
    """The alternative died at once, and a tare that was forced on a touch was believed."""
    phases = phases_of(PRESS)
    phases[60] = PRESS / 3
    rows, press_filter = rows_by_off_states(off, phases), filter_for(off)
    explained(rows[:61], press_filter)
    press_filter.claim_untouched(0.5)
    for name in ("phase", "amplitude"):
        rows[name][61:] = rows[name][60]
    explained(rows[61:63], press_filter)
    newest = press_filter.newest()
    assert 0.2 < newest["weight"][newest["is"] == UNTOUCHED].sum() < 0.9


@pytest.mark.parametrize("off", [(0.3, 0.3), (0.3, 0.29), (0.02, 0)])
def test_uneven_loss_is_a_press_where_off_states_hardly_differ(off):
    """Estimated off states are never equal, and every press was inconsistent because of it."""
    rows = rows_by_off_states(off, phases_of(PRESS), lost_np=0.03)
    found = explained(rows, filter_for(off))
    assert state_of(found, 100) == (PRESSED, pytest.approx(1, abs=0.01))


@pytest.mark.parametrize("off", [0.3, -0.3])
def test_press_at_mid_line_is_not_read_as_untouched_where_both_switches_reflect(off):
    rows = rows_by_off_states((off, off), phases_of(MIDDLE))
    assert share_of(UNTOUCHED, rows, filter_for(off))[100] < 0.99


@pytest.mark.parametrize("off", [0.116 - 0.172j, -0.191 - 0.012j])
def test_force_that_rises_slowly_is_followed_where_both_switches_reflect(off):
    """The off state changes the amplitude with the phases; it was taken for a turning tag."""
    force = np.interp(np.arange(300), (70, 140), (0.2, 4.0))
    phases = np.array([MODEL.phases_deg(each, 50.0) for each in force]) - MODEL.untouched_deg()
    phases[:70] = 0
    phases += 0.1 * np.random.default_rng(2).standard_normal(phases.shape)
    found = explained(rows_by_off_states((off, off), phases, noise_deg=0.1), filter_for(off))
    here = found[found["row"] > 150]
    turned = np.degrees(np.abs(here["baseline"]).max(axis=1)) > 1
    assert here["weight"][turned].sum() < 0.01 * here["weight"].sum()


@pytest.mark.parametrize("drift_deg, warms", [(-1.0, True), (0.0, False)])
def test_finger_warms_no_line_that_is_said_to_stay(drift_deg, warms):
    forces = np.interp(np.arange(300), (70, 75, 145), (0.2, 3.0, 4.0))
    phases = np.array([MODEL.phases_deg(each, 40.0) for each in forces]) - MODEL.untouched_deg()
    phases[:70] = 0
    rows = rows_of(phases, noise_deg=0.03, untouched=60)
    found = explained(rows, drift_deg=drift_deg, turns=0.0, hands=0.0)
    here = found[found["row"] > 200]
    turned = np.degrees(np.abs(here["baseline"]).max(axis=1)) > 1
    assert (here["weight"][turned].sum() > 0.03 * here["weight"].sum()) == warms


def test_reference_may_be_exchanged_at_any_time():
    """The same groups against another reference: the same explanations, turned."""
    rows = rows_of(phases_of(PRESS))
    plain = explained(rows)
    press_filter, turn = filter_for(), np.radians([12.0, -7.0])
    press_filter.take(rows[:90])
    press_filter.change_reference(-turn, np.zeros(2))
    rows["phase"][90:] -= turn
    found = explained(rows[90:], press_filter)
    for group in (0, 20, 60, 85):
        now, then = (each[each["row"] == at] for each, at in ((found, group), (plain, group + 90)))
        assert now["is"][0] == then["is"][0]
        np.testing.assert_allclose(now["baseline"][0] + turn, then["baseline"][0], atol=1e-6)


def test_group_that_cannot_be_read_changes_nothing():
    rows = rows_of(phases_of(PRESS))
    press_filter = filter_for()
    press_filter.take(rows[:100])
    before = press_filter.newest()
    lost = rows[100:101].copy()
    lost["phase"] = np.nan
    np.testing.assert_array_equal(press_filter.take(lost), before)


def test_groups_that_a_silence_cuts_are_no_turns():
    """They counted as turns, and then a press at mid-line was one more, while nobody touched."""
    rows = rows_of(phases_of(MIDDLE, 122, 60, 0), period_s=0.036)
    for begins in range(30, 175, 9):
        rows["phase"][begins + 1 : begins + 5] = np.nan
        rows["amplitude"][[begins, begins + 5]] = np.log(0.5)
    found = explained(rows)
    read = np.isfinite(rows["phase"][:-1, 0]) & (rows["amplitude"][:-1, 0] == 0)
    pressed = probability(found, found["is"] == PRESSED, len(rows) - 1)
    assert pressed[125:][read[125:]].min() > 0.99
    assert probability(found, found["turns"], len(rows) - 1)[read].max() < 0.05


def test_press_lasts_through_groups_in_which_the_supply_fails():
    """A moved line that nobody touches came back to what it was, and a press could not."""
    rows = rows_of(phases_of(MIDDLE, 30, 90, 0, noise_deg=0.03), noise_deg=0.03, period_s=0.144)
    failing = np.arange(40, 119, 5)
    rows["amplitude"][failing] = np.log(np.linspace(0.3, 0.6, len(failing)))[:, None]
    assert share_of(UNTOUCHED, rows)[31:119].max() < 0.01


@pytest.mark.parametrize("shares", [(0.93,), (0.9, 0.8), (0.6, 0.93), (0.3, 0.5)])
def test_press_that_fills_no_group_is_a_mixture(shares):
    """It looked like a harder press, whose contact loses a little of the amplitude."""
    ratios = np.ones((60, 2), complex)
    for begin in range(20, 60, 8):
        for i, share in enumerate(shares):
            ratios[begin + i] = 1 - share + share * np.exp(1j * np.radians(PRESS))
    noise = np.random.default_rng(1).standard_normal((2, 60, 2)) * np.radians(0.1)
    ratios += noise[0] + 1j * noise[1]
    rows = rows_of(np.degrees(np.angle(ratios)), noise_deg=0.1, period_s=0.036, untouched=10)
    rows["amplitude"] = np.log(abs(ratios))
    mixed = share_of(MIXED, rows)
    partial = np.add.outer(np.arange(20, 56, 8), np.arange(len(shares))).ravel()
    assert mixed[partial].min() > 0.1, mixed[partial]


@pytest.mark.parametrize("noise_deg", [(0.05, 0.16), (0.4, 0.1)])
def test_press_is_held_where_one_end_is_noisier(noise_deg):
    """Its mean and difference were compared as if their noise were independent: a turning tag
    predicted both better."""
    noise = np.array(noise_deg)
    rows = rows_of(phases_of(MIDDLE, 60, 300, 0, noise_deg=noise), noise_deg=noise)
    found = explained(rows)
    last = found[found["row"] == 350]
    assert np.degrees(np.sqrt(last["weight"] @ last["common_variance"])) < 0.3


def test_line_whose_ends_differ_in_noise_errs_as_stated():
    """Its mean was corrected by the error of the difference, which lasts, as if it were new."""
    noise, errors = np.array((0.05, 0.3)), []
    for seed in range(40):
        rows = rows_of(phases_of(PRESS, 100, 0, 0, noise_deg=noise, seed=seed), noise_deg=noise)
        found = explained(rows, drift_deg=0.0)
        last = found[found["row"] == 98][0]
        mean = np.degrees(last["baseline"].mean())
        errors.append(mean / np.degrees(np.sqrt(last["common_variance"])))
    assert 0.75 < np.sqrt(np.mean(np.square(errors))) < 1.25


def test_line_drifts_by_half_of_what_a_held_press_does_within_the_other_half():
    """A finger that warms a line turns it slowly; the force was read from where it had been."""
    phases_deg = phases_of(PRESS, 30, 40, 0, noise_deg=0.03)
    warm_deg = np.clip(0.08 * (np.arange(70) - 32), 0, None)
    rows = rows_of(phases_deg + warm_deg[:, None], noise_deg=0.03, period_s=0.144)
    found = explained(rows)
    held = found[(found["row"] == 68) & (found["is"] == PRESSED)]
    baseline_deg = np.degrees(held["weight"] @ held["baseline"] / held["weight"].sum())
    deviation_deg = np.degrees(np.sqrt(held["weight"] @ held["common_variance"]))
    assert 0.3 * warm_deg[68] < baseline_deg.mean() < warm_deg[68]
    assert abs(baseline_deg.mean() - warm_deg[68]) < 2 * deviation_deg < warm_deg[68]


def approach(time_s, force_n):
    """Hand that comes from .3 s before a press on: 8 deg and 10 % at both ends."""
    near = np.interp(time_s, [1.7, 2, 4.05, 4.4, 4.7, 5, 8.05, 8.4], [0, 1, 1, 0, 0, 1, 1, 0])
    return 1j * np.radians(8 * near) + np.log1p(0.1 * near)


def push(time_s, force_n):
    """Sensor that a press turns, both ends by 4 deg/N."""
    return 1j * np.radians(4 * force_n)


@pytest.mark.parametrize("moves", [approach, push])
def test_press_at_mid_line_beside_a_turn_is_not_missed(moves):
    """In long groups a turn of the tag could be so fast that it explained each press."""
    period_s, noise, parts = 0.144, np.radians(0.035), 72
    time_s = (np.arange(62 * parts) + 0.5) * period_s / parts
    steps = [0, 2, 2.05, 3, 4, 4.05, 5, 5.1, 8, 8.05], [0, 0, 3, 3.96, 5, 0, 0, 4, 4, 0]
    force_n = np.interp(time_s, *steps)
    phases_deg = np.array(MODEL.phases_deg(np.maximum(force_n, 1e-3), 40.0))
    phases_deg[force_n < MODEL.onset_force_n] = MODEL.untouched_deg()
    changes = 1j * np.radians(phases_deg - MODEL.untouched_deg())
    ratios = np.exp(changes + moves(time_s, force_n)[:, None]).reshape(-1, parts, 2).mean(axis=1)
    rng = np.random.default_rng(1)
    ratios += noise * (rng.standard_normal(ratios.shape) + 1j * rng.standard_normal(ratios.shape))
    rows = rows_of(np.degrees(np.angle(ratios)), period_s=period_s, untouched=3)
    rows["amplitude"], rows["variance"] = np.log(abs(ratios)), noise**2
    untouched = share_of(UNTOUCHED, rows, smoothing_s=SMOOTHING_S)
    pressed = force_n.reshape(-1, parts).min(axis=1) > 1.2
    pressed[-1] = False  # of which nothing is given yet
    # A release to where the line was speaks for a turn back as well, in the group before it.
    assert pressed.sum() == 33 and untouched[pressed][:-1].max() < 0.9


@pytest.mark.parametrize("period_s", [0.0072, 0.144])
def test_nothing_that_happens_is_no_evidence_of_a_touch(period_s):
    """A sensor that nobody touches for half a minute was read as touched, without a flag."""
    groups = int(30 / period_s)
    untouched = share_of(UNTOUCHED, rows_of(phases_of(0, groups, 0, 0), period_s=period_s))
    assert untouched[int(1 / period_s) :].min() > 0.99


@pytest.mark.parametrize("step_np", [-0.03, 0.03, 0.1])
def test_amplitude_that_steps_during_a_press_is_no_release(step_np):
    """A card's states changed it by 2 %: the press read as untouched, with another line."""
    rows = rows_of(phases_of(PRESS, 20, 60, 0, 0.15), noise_deg=0.15, period_s=0.1, untouched=5)
    for group in (40, 50, 55):
        rows["amplitude"][group:] += step_np
    found = explained(rows)
    untouched = probability(found, found["is"] == UNTOUCHED, len(rows))
    assert untouched[21:].max() < 0.5
    assert state_of(found, 75)[0] == PRESSED


@pytest.mark.parametrize("inside", [False, True], ids=["between groups", "in a group"])
@pytest.mark.parametrize("step_db", [6, 10])
def test_level_that_falls_in_a_press_and_rises_in_the_next_moves_no_line(step_db, inside):
    """A turn by as much as the press, with the release, explained the level: 'untouched'."""
    rng = np.random.default_rng(1)
    pressed = np.zeros(420, bool)
    pressed[60:160] = pressed[220:320] = True
    phases = np.where(pressed[:, None], MIDDLE, 0.0)
    rows = rows_of(phases + NOISE_DEG * rng.standard_normal(phases.shape))
    level = np.ones(len(rows))
    level[110:270] = 10 ** (-step_db / 20)
    if inside:
        level[[110, 270]] = (1 + level[120]) / 2
    rows["amplitude"] = np.log(level)[:, None] + 0.003 * rng.standard_normal(phases.shape)
    found = explained(rows)
    right = probability(
        found, found["is"] == np.where(pressed, PRESSED, UNTOUCHED)[found["row"]], 420
    )
    for first, last in ((70, 108), (115, 155), (165, 215), (225, 265), (275, 315), (330, 400)):
        assert right[first:last].mean() > 0.6, (first, last)


@pytest.mark.parametrize("noise_deg", [0.03, 0.3])
@pytest.mark.parametrize("apart_np", [0.0, 0.03])
def test_ends_whose_amplitudes_drift_apart_are_untouched(apart_np, noise_deg):
    """Where off states differ, such a line was touched for good from 0.008 Np on."""
    off, count = (0.3, -0.3), int(36 / 0.036)
    noise = np.radians(noise_deg) * np.random.default_rng(1).standard_normal((2, count, 2))
    rows = rows_by_off_states(off, np.zeros((count, 2)), noise_deg=noise_deg, period_s=0.036)
    rows["phase"] += noise[0]
    rows["amplitude"] += noise[1] + np.linspace(0, apart_np / 2, count)[:, None] * [1, -1]
    assert share_of(UNTOUCHED, rows, filter_for(off, 0.036))[30:-1].min() > 0.99


def test_press_beside_a_turn_that_takes_groups_leaves_its_end_in_doubt():
    """A contact may come before a turn of some groups, too fast for longer ones, has ended."""
    period_s = 0.0036
    phases = phases_of(MIDDLE - 28, pressed=40, released=0, noise_deg=0.1)
    phases[57:60] += [[-5], [-12], [-20]]
    found = explained(rows_of(phases, noise_deg=0.1, period_s=period_s), turns_per_s=0.3)
    here = found[(found["row"] == 70) & (found["is"] == PRESSED)]
    beside = np.degrees(here["baseline"].mean(axis=1)) + 28
    within = np.abs(beside) < 2 * np.degrees(np.sqrt(here["common_variance"]))
    assert here["weight"][within].sum() > 1e-3


def test_force_that_rises_slowly_at_mid_line_is_not_taken_for_warmth_alone():
    """Both explain it as well, so that neither is lost while it lasts."""
    force = np.linspace(1.3, 3.9, 120)
    press = np.array([MODEL.phases_deg(f, 40.0) for f in force]) - MODEL.untouched_deg()
    phases = phases_of(press, pressed=120, released=0, noise_deg=0.03)
    found = explained(rows_of(phases, noise_deg=0.03, period_s=0.036))
    stays = np.abs(np.degrees(found["baseline"].mean(axis=1))) < 0.3
    assert probability(found, stays & (found["is"] == PRESSED), 180)[60:150].min() > 1e-3


def test_press_lasts_through_groups_of_something_else():
    """It is not replaced by another one, which would be as likely as an untouched line there."""
    model = wiforce.load_sensor("wiforce-2400mhz")
    press = np.asarray(model.phases_deg(1.5, 40.0)) - model.untouched_deg()
    press = (press + 180) % 360 - 180  # 30 and 27 degrees
    rows = rows_of(phases_of(press, pressed=100, noise_deg=0.3), noise_deg=0.3, period_s=0.036)
    rng = np.random.default_rng(5)
    for group in (70, 76, 82, 88):
        seen = np.exp(1j * rows["phase"][group])
        seen += rng.uniform(0.3, 1.2) * np.exp(2j * np.pi * rng.random(2))
        rows["phase"][group], rows["amplitude"][group] = np.angle(seen), np.log(np.abs(seen))
    untouched = share_of(UNTOUCHED, rows, filter_of(model, 2400e6, 0.0, period_s=0.036))
    assert untouched[62:158].max() < 0.01


def test_line_that_cools_after_a_release_is_not_touched():
    phases = phases_of(MIDDLE, pressed=100, released=120, noise_deg=0.03)
    phases[160:] += 1.2 * np.exp(-0.036 * np.arange(120) / 2)[:, None]
    found = explained(rows_of(phases, noise_deg=0.03, period_s=0.036))
    touched = probability(found, found["is"] != UNTOUCHED, 280)
    assert touched[180:278].max() < 0.05 and touched[270] < 1e-3


def test_receiver_that_seems_to_be_known_exactly_is_no_reason_to_begin_anew():
    rows = rows_of(phases_of(PRESS))
    rows["receiver_variance"] = 0
    assert state_of(explained(rows), 100) == (PRESSED, pytest.approx(1, abs=0.01))


def test_average_of_a_press_is_without_a_group_of_something_else():
    phases = phases_of(PRESS, pressed=100)
    phases[100] += (25, -15)
    rows = rows_of(phases)
    rows["amplitude"][100] = -0.4
    found = explained(rows, smoothing_s=SMOOTHING_S)
    first = likeliest(found, len(phases))
    after = found[first[101:106]]
    assert (after["is"] == PRESSED).all()
    off = np.degrees(np.angle(ratios_of(after) * np.exp(-1j * np.radians(PRESS))))
    assert np.abs(off).max() < 4 * NOISE_DEG


@pytest.mark.parametrize("seed", cases(4, 5, long=range(4)))
@pytest.mark.parametrize("drift_deg", [0.03, 0.3, 1.0])
def test_ends_of_unequal_noise_are_followed_as_by_a_filter_of_each(drift_deg, seed):
    """Mean and difference were each followed alone: a drift looked like a creeping press."""
    noise_deg, period_s, groups = np.array([0.3, 0.075]), 0.036, 400
    expected = 0
    for noise in noise_deg**2:  # in the steady state, of a random walk
        walk = drift_deg**2 * period_s
        expected += (np.sqrt(walk**2 / 4 + walk * noise) - walk / 2) / 4
    rng = np.random.default_rng(seed)
    steps = drift_deg * np.sqrt(period_s) * rng.standard_normal((groups, 2))
    phases = np.cumsum(steps, axis=0) + noise_deg * rng.standard_normal((groups, 2))
    rows = rows_of(phases, noise_deg=noise_deg, period_s=period_s, untouched=5)
    found = explained(rows, drift_deg=drift_deg)
    assert probability(found, found["is"] == UNTOUCHED, groups).min() > 0.99
    # Beside the error that no noise explains, and turns that may happen: a quarter more.
    first = likeliest(found, groups)
    variance = np.degrees(np.degrees(found["common_variance"][first[200:]])).mean()
    assert variance == pytest.approx(expected, rel=0.25, abs=2e-4)
    assert share_of(UNTOUCHED, rows)[20:].min() > 0.5  # likewise of a drift that is learned


def test_levels_of_amplitudes_change_no_probability():
    """Groups in which a press begins or ends were too likely below the level of the reference."""
    rows = rows_of(phases_of(PRESS), untouched=5)
    for group in (60, 120):  # in the middle of which it begins or ends
        seen = (1 + np.exp(1j * np.radians(PRESS))) / 2
        rows["phase"][group], rows["amplitude"][group] = np.angle(seen), np.log(np.abs(seen))
    states = (UNTOUCHED, PRESSED, MIXED)
    former = [share_of(state, rows) for state in states]
    rows["amplitude"] += np.log(0.3)
    np.testing.assert_allclose([share_of(state, rows) for state in states], former, atol=1e-6)


def test_difference_is_known_while_an_untouched_tag_turns():
    """It went on growing as if nothing was seen of it."""
    phases = phases_of(0, 130, 0, 0)
    turning = phases + np.maximum(0, np.arange(130) - 100)[:, None] * 30 * PERIOD_S
    variances = []
    for seen in (phases, turning):
        found = explained(rows_of(seen), drift_deg=0.3, turns_per_s=0.3)
        first = likeliest(found, 130)
        assert (found["is"][first[105:120]] == UNTOUCHED).all()
        variances.append(found["difference_variance"][first[105:120]].mean())
    assert variances[1] < 1.5 * variances[0]


def test_cable_that_moves_beside_a_press_takes_its_amplitude_along():
    """The release showed an amplitude that the line was not thought to have."""
    phases = phases_of(PRESS, 60, 120, 60)
    rows = rows_of(phases)
    rows["phase"][120:, 0] += np.radians(8)
    rows["amplitude"][120:, 0] -= 0.1
    found = explained(rows)
    assert probability(found, found["is"] == UNTOUCHED, len(rows))[182:].min() > 0.9
    first = likeliest(found, len(rows))
    end = found[first[230]]
    np.testing.assert_allclose(np.degrees(end["baseline"]), (8, 0), atol=0.3)
    np.testing.assert_allclose(end["amplitude"], (-0.1, 0), atol=0.01)
    held = found[first[170]]  # the line follows before the release
    np.testing.assert_allclose(held["amplitude"], (-0.1, 0), atol=0.02)


@pytest.mark.parametrize("end", [0, 1])
def test_cable_that_moves_beside_a_press_is_named_where_off_states_differ(end):
    """They resolve turns of the tag, which both ends share, not what moves one of them."""
    off = (0.3, -0.3)
    rows = rows_by_off_states(off, phases_of(PRESS, 60, 120, 60))
    rows["phase"][120:, end] += np.radians(8)
    found = explained(rows, filter_for(off))
    moved = np.bincount(found["row"], found["weight"] * found["turns"])
    assert moved[120] > 0.5
    assert moved[[119, 121]].max() < 0.1


def test_tag_on_an_arm_turns_without_another_amplitude():
    """Each group paid for an amplitude that the turn might have changed, and a slide did not."""
    rng, groups = np.random.default_rng(1), 1000
    time = PERIOD_S * np.arange(groups)
    turned = 6.4 * np.clip(time - 2, 0, 4)  # 3 mm/s at 900 MHz
    phases = (time > 1)[:, None] * PRESS + turned[:, None]
    phases += NOISE_DEG * rng.standard_normal(phases.shape)
    rows = rows_of(phases)
    rows["amplitude"] = np.radians(NOISE_DEG) * rng.standard_normal(phases.shape)
    found = explained(rows, turns_per_s=0.3)
    follows = found["baseline"].mean(axis=1) > np.radians(20)
    assert probability(found, follows & (found["is"] == PRESSED), groups)[950:-1].min() > 0.9


def test_press_that_changes_stays_among_the_presses_of_the_model():
    """A held press that turns by a whole circle was another press at each angle."""
    phases = phases_of(PRESS, 60, 400, 0)
    phases[120:] += 60 * PERIOD_S * np.arange(340)[:, None]  # 147 degrees in the end
    found = explained(rows_of(phases), turns_per_s=0.3)
    turned = found["baseline"].mean(axis=1) > np.radians(100)
    assert probability(found, turned & (found["is"] == PRESSED), 460)[440:-1].min() > 0.9


def test_force_that_changes_at_mid_line_pays_once_for_the_error_of_its_direction():
    """A turn moves both phases alike; a force errs from the image by an angle, in all groups."""
    model, period_s = wiforce.load_sensor("line-2400mhz"), 0.036
    force = np.interp(period_s * np.arange(40), (0.2, 0.8), (1.5, 6.0))
    press = np.array([model.phases_deg(f, 40.0) for f in force]) - model.untouched_deg()
    phases = phases_of(press, 20, 40, 0, noise_deg=0.1)
    calibrated = wiforce.load_sensor("line-2400mhz-calibrated")
    filters = filter_of(calibrated, 2.4e9, 0.0, period_s=period_s)
    found = explained(rows_of(phases, noise_deg=0.1, period_s=period_s), filters)
    turned = np.abs(np.degrees(found["baseline"].mean(axis=1))) > 1
    assert probability(found, turned, 60)[21:-1].max() < 0.02
