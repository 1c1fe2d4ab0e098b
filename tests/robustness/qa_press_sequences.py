# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever happens to a sensor, a reading is right or flagged.

Limits in these tests are what docs/press.md states, with room for a sequence that is bad as a
whole: all readings of a long press are wrong together.
"""

import pytest
from long_cases import cases
from press_sequences import FAMILIES, Sequence
from sequence_readings import by_receiver, by_stream, score

# What looks like a press where it coincides with one.
TURNING = "turns", "turning mixture", "cables", "brownouts", "off states alike"
# Of unflagged readings, for a few sequences and for 200.
SHORT, LONG = 1e-3, 2e-4
SHORT_TURNING = 3e-2
LONG_TURNING = {
    "turns": 5e-3,
    "turning mixture": 5e-3,
    "cables": 2e-2,
    "brownouts": 5e-3,
    "off states in error": 5e-3,
    "off states alike": 5e-3,
    "warm": 3e-2,
}
# Where a stream has more to do than to read groups: some are missing, or there are tares.
IN_STREAMS = "gaps", "silence", "tares", "mixture", "turning mixture"
# Two sequences of short groups where all that may happen does, four of longer ones of each family.
SHORT_CASES = [(family, 625) for family in FAMILIES]
SHORT_CASES += [(family, 125) for family in ("mixture", "turning mixture", "hand")]
LONG_CASES = sorted({(f, n) for f in FAMILIES for n in (63, 125, 625, 2500)} - {*SHORT_CASES})


def assert_honest(found, family, limit):
    if limit == LONG:
        limit = LONG_TURNING.get(family, LONG)
    elif family in TURNING:
        limit = SHORT_TURNING
    assert len(found.wrong) <= limit * found.counts["unflagged"], "\n".join(
        [str(found), *found.wrong[:10]]
    )
    assert not found.far or family in LONG_TURNING, "\n".join(found.far[:10])


@pytest.mark.timeout(3000)
@pytest.mark.parametrize("family, snapshots", cases(*SHORT_CASES, long=LONG_CASES))
def test_separated_groups_leave_no_wrong_reading_without_a_flag(family, snapshots, long_run):
    seeds = range(200 if long_run else 2 + snapshots // 300)
    found = score(seeds, snapshots, family, by_receiver)
    assert_honest(found, family, LONG if long_run else SHORT)
    if family == "off states":
        assert found.share("pressed, read", "pressed") > 0.7
    if family == "off states in error":
        assert found.share("pressed, inside", "pressed, read") > 0.95
    if family == "plain":
        assert found.share("pressed, read", "pressed") > 0.75
        assert found.share("untouched, read", "untouched") > 0.95
    elif family not in ("hand", "contacts", "off states in error", "tremor", *TURNING):
        assert found.share("pressed, read", "pressed") > 0.45


@pytest.mark.timeout(3000)
@pytest.mark.parametrize("snapshots", cases(625, long=(63, 125, 2500)))
@pytest.mark.parametrize("family", cases(*IN_STREAMS, long=sorted({*FAMILIES} - {*IN_STREAMS})))
def test_streams_leave_no_wrong_reading_without_a_flag(family, snapshots, long_run):
    found = score(range(50 if long_run else 1), snapshots, family, by_stream)
    # A single sequence of 400 groups.
    assert_honest(found, family, LONG if long_run else 5e-3)


@pytest.mark.parametrize("seed", [40, 94])
def test_turns_during_touches_are_followed_by_off_states_in_error(seed):
    """One that slows, and one that begins while a press slides, were taken for force."""
    found = score([seed], 625, "off states in error")
    assert not found.wrong, str(found)


@pytest.mark.parametrize("family, seed", [("off states", 155), ("drift", 181)])
def test_changes_inside_two_groups_leave_the_line(family, seed):
    """Another press while the tag turns by 29 degrees; one that rises in part of a group."""
    found = score([seed], 625, family)
    assert not found.wrong and found.counts["unflagged"] > 300, str(found)


def test_a_force_that_swings_is_not_taken_for_a_turning_tag():
    """At mid-line each swing showed that the model's direction is not exact, again and again."""
    found = score([6], 125, "tremor")
    assert not found.wrong and found.counts["unflagged"] > 1500, str(found)


def test_a_force_that_changes_goes_on_while_the_supply_fails():
    """Only a turning tag went on, so that a changing force was taken for a turn at mid-line."""
    found = score([5], 625, "brownouts")
    assert not found.wrong and found.counts["unflagged"] > 150, str(found)


def test_a_force_that_rises_while_a_hand_moves_is_doubted_in_short_groups():
    """They were divided anew in each group, as if that erred by something else each time."""
    found = score([8], 63, "hand")
    assert not found.wrong and found.counts["unflagged"] > 1000, str(found)


@pytest.mark.parametrize("family, seed", [("brownouts", 49), ("warm", 54)])
def test_a_line_that_is_doubted_reads_no_press_confidently(family, seed):
    """A supply that fails, and a line that a finger warms."""
    found = score([seed], 2500, family)
    assert not found.wrong and found.counts["unflagged"] > 20, str(found)


def test_a_sudden_turn_after_a_silence_is_followed():
    """A silence of two seconds leaves the common phase unknown by radians, beside microradians."""
    readings = by_receiver(Sequence(184, 2500, "mixture"))
    assert all(reading.force_std_n >= 0 for reading in readings if reading.force_n is not None)
    assert readings
