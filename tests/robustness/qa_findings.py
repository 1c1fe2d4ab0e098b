# SPDX-License-Identifier: GPL-3.0-or-later
"""Nothing that was once read wrong without a flag is so again, however it is varied."""

import pytest
from findings import KINDS, Finding
from long_cases import cases
from sequence_readings import Score, by_receiver, by_stream

# Of unflagged readings. Where a cable has moved both lines stay possible, and the group before a
# slow release may fit the wrong one better until the sensor is untouched. Where both ends change
# alike to a tenth of a degree, a turn of the tag is as likely as a contact beside the model, and
# cables of both ends that move alike in a press are one.
MOST_WRONG = {
    "cables": 2e-3,
    "cables beside a press": 2e-2,
    "ends alike": 0.15,
    "wide contact": 3e-4,
}


def assert_none_wrong(kind, snapshots, seeds, read):
    found = Score()
    for seed in range(seeds):
        capture = Finding(kind, seed, snapshots)
        found.add(capture, read(capture))
    most = MOST_WRONG.get(kind, 0.0) * found.counts["unflagged"]
    assert len(found.wrong) <= most, "\n".join([str(found), *found.wrong[:10]])
    assert found.counts["unflagged"] > 0


@pytest.mark.timeout(3000)
@pytest.mark.parametrize("snapshots", cases(625, long=(125, 2500)))
@pytest.mark.parametrize("kind", KINDS)
def test_finding_is_flagged_in_separated_groups(kind, snapshots, long_run):
    assert_none_wrong(kind, snapshots, 20 if long_run else 4, by_receiver)


@pytest.mark.long
@pytest.mark.timeout(3000)
@pytest.mark.parametrize("snapshots", [125, 625, 2500])
@pytest.mark.parametrize("kind", KINDS)
def test_finding_is_flagged_in_streams(kind, snapshots):
    assert_none_wrong(kind, snapshots, 20, by_stream)
