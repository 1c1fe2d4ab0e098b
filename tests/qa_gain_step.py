# SPDX-License-Identifier: GPL-3.0-or-later
"""Steps of the receiver's gain, which look like a change of force."""

import numpy as np
import pytest
from gnuradio.wiforce.estimation.gain_step import GainStep

PERIOD_S, STD_DEG = 0.036, 0.04


def stepped(factor, disturbed_deg, touch=None, ends=(1, 1), renewed=None, groups=40, step=20):
    """Flags of groups whose R changes by a factor; the step lies in group ``step``."""
    rng = np.random.default_rng(1)
    noise = np.radians(STD_DEG) * rng.standard_normal((groups, 2, 2)) @ [1, 1j]
    ratios = np.exp([0.5j, 1j]) + noise
    ratios[step:] *= np.where(ends, factor, 1)
    std_deg = np.full((groups, 2), STD_DEG)
    std_deg[step] = disturbed_deg
    touch = np.ones(groups, int) if touch is None else touch
    renewed = np.zeros(groups, bool) if renewed is None else renewed
    detector, rows = GainStep(PERIOD_S), np.arange(groups)
    parts = [
        detector.process(renewed[part], touch[part], ratios[part], std_deg[part])
        for part in np.array_split(rows, 7)
    ]
    return np.flatnonzero(np.concatenate(parts)).tolist()


@pytest.mark.parametrize("factor", [0.9 * np.exp(0.03j), 0.5, 1.05 * np.exp(-0.02j)])
def test_gain_step_during_a_touch_flags_the_rest_of_it(factor):
    """2 degrees are 2 N: the readings would be wrong without any sign.

    The group of the step may be uncertain enough to hide it.
    """
    first, *others = stepped(factor, 20 * abs(1 - factor))
    assert first in (20, 21) and others == list(range(first + 1, 40))


def test_gain_step_in_a_single_group_is_taken_back():
    """A group in which a press of another sensor begins is no step."""
    ratios = np.ones((40, 2)) * np.exp([0.5j, 1j])
    ratios[20:22] *= 0.9
    std_deg = np.full((40, 2), STD_DEG)
    std_deg[20] = 1.0
    touch, renewed = np.ones(40, int), np.zeros(40, bool)
    flagged = GainStep(PERIOD_S).process(renewed, touch, ratios, std_deg)
    assert np.flatnonzero(flagged).tolist() == [20, 21]


def test_gain_step_is_not_seen_in_the_begin_of_a_press():
    """Phases that turn within a group lower its magnitude."""
    ratios = np.ones((40, 2)) * np.exp([0.5j, 1j])
    ratios[:19], ratios[19] = 1.0, 0.9 * np.exp(0.5j)
    std_deg = np.full((40, 2), STD_DEG)
    std_deg[20] = 2.0
    touch, renewed = (np.arange(40) > 18).astype(int), np.zeros(40, bool)
    assert not GainStep(PERIOD_S).process(renewed, touch, ratios, std_deg).any()


def test_gain_step_is_forgotten_after_release_and_by_a_tare():
    """Presses that come later are compared with phases that are known again."""
    touch, renewed = np.ones(40, int), np.zeros(40, bool)
    touch[25:30] = 0
    assert stepped(0.9, 1.0, touch) == list(range(20, 25))
    renewed[30] = True
    assert stepped(0.9, 1.0, renewed=renewed) == list(range(20, 30))


def test_gain_step_right_before_or_with_a_touch_flags_it():
    """An automatic gain control follows the hand that presses."""
    for first in (20, 22):
        touch = (np.arange(40) >= first).astype(int)
        assert stepped(0.9, 1.0, touch) == list(range(first, 40))


def test_gain_step_presses_doors_and_losses_are_none():
    """A press that is held while a door closes, or loses some of the signal, stays readable."""
    assert stepped(1.0, 5.0) == []  # only the static path changed
    assert stepped(0.9, STD_DEG) == []  # nothing disturbed: the contact loses some of the signal
    assert stepped(0.95 * np.exp(0.6j), 0.24) == []  # a press is no more than this
    assert stepped(0.9, 1.0, ends=(1, 0)) == []
