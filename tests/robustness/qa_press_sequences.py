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
# Of unflagged readings, for a few sequences and for 200; and of those far off in 200.
SHORT, LONG, FAR = 1e-3, 2e-4, 1e-4
SHORT_TURNING = 3e-2
LONG_TURNING = {
    "turns": 5e-3,
    "turning mixture": 5e-3,
    "cables": 2e-2,
    "brownouts": 5e-3,
    "off states in error": 5e-3,
    "off states alike": 5e-3,
    "warm": 5e-3,
    "hand": 1e-2,
    "bursts": 5e-3,  # those that fill a small part of a long group
}
# Of which less than half of the touched readings has no flag.
UNSTEADY = "hand", "contacts", "off states in error", "tremor", *TURNING
# Where a stream has more to do than to read groups: some are missing, or there are tares.
IN_STREAMS = "gaps", "silence", "tares", "mixture", "turning mixture"
# Two sequences of short groups where all that may happen does, four of longer ones of each family.
SHORT_CASES = [(family, 625) for family in FAMILIES]
SHORT_CASES += [(family, 125) for family in ("mixture", "turning mixture", "hand", "bursts")]
LONG_CASES = sorted({(f, n) for f in FAMILIES for n in (63, 125, 625, 2500)} - {*SHORT_CASES})


def assert_honest(found, family, limit):
    if limit == LONG:
        limit = LONG_TURNING.get(family, LONG)
    elif family in TURNING:
        limit = SHORT_TURNING
    assert len(found.wrong) <= limit * found.counts["unflagged"], "\n".join(
        [str(found), *found.wrong[:10]]
    )
    far = FAR * found.counts["unflagged"] if limit == LONG else 0
    assert len(found.far) <= far or family in LONG_TURNING, "\n".join(found.far[:10])


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
    elif found.counts["pressed"] and family not in UNSTEADY:
        assert found.share("pressed, read", "pressed") > 0.45


@pytest.mark.timeout(3000)
@pytest.mark.parametrize("snapshots", cases(625, long=(63, 125, 2500)))
@pytest.mark.parametrize("family", cases(*IN_STREAMS, long=sorted({*FAMILIES} - {*IN_STREAMS})))
def test_streams_leave_no_wrong_reading_without_a_flag(family, snapshots, long_run):
    found = score(range(50 if long_run else 1), snapshots, family, by_stream)
    # A single sequence of 400 groups.
    assert_honest(found, family, LONG if long_run else 5e-3)


# Sequences that were once read wrong, and how many readings of them have no flag at least.
ONCE_WRONG = [
    # A turn that slows, and one that begins while a press slides, were taken for force.
    ("off states in error", 40, 625, 0),
    ("off states in error", 94, 625, 0),
    # Of a held press a turning tag seemed to predict noise that differs between the ends better.
    ("off states in error", 15, 125, 1200),
    # Another press while the tag turns by 29 degrees; one that rises in part of a group.
    ("off states", 155, 625, 300),
    ("drift", 181, 625, 300),
    # At mid-line each swing of a force showed that the model's direction is not exact.
    ("tremor", 6, 125, 1500),
    # Only a turning tag went on while the supply failed, so that a changing force was a turn.
    ("brownouts", 5, 625, 150),
    # Groups in which a force rises and a hand moves were divided anew, as if each erred otherwise.
    ("hand", 8, 63, 1000),
    # A line that is doubted reads no press confidently, nor does one that a finger warms.
    ("brownouts", 49, 2500, 20),
    ("warm", 54, 2500, 20),
    # A finger that warms the line for seconds was taken for a force that creeps.
    ("warm", 159, 625, 200),
    # A turn that takes several short groups was thought to end in each.
    ("off states alike", 19, 63, 2000),
    # At mid-line a force that falls slowly was taken for warmth.
    ("plain", 174, 625, 200),
    ("slow forces", 16, 625, 200),
    # A release and the next press in two groups of 144 ms; the first began to be the next line.
    ("gaps", 149, 2500, 150),
]


@pytest.mark.parametrize("family, seed, snapshots, unflagged", ONCE_WRONG)
def test_sequence_that_was_once_read_wrong_is_not(family, seed, snapshots, unflagged):
    found = score([seed], snapshots, family)
    assert not found.wrong and found.counts["unflagged"] > unflagged, str(found)


def test_a_sudden_turn_after_a_silence_is_followed():
    """A silence of two seconds leaves the common phase unknown by radians, beside microradians."""
    readings = by_receiver(Sequence(184, 2500, "mixture"))
    assert all(reading.force_std_n >= 0 for reading in readings if reading.force_n is not None)
    assert readings
