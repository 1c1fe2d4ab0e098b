# SPDX-License-Identifier: GPL-3.0-or-later
"""However presses follow each other, a reading is right or flagged."""

import pytest
from press_sequences import Sequence

SEEDS, LONG_SEEDS = 12, 200
# Noise at large forces: docs/theory.md, section "Limits". A fault of a rule gives tens at once.
_BY_NOISE = 2e-4


@pytest.mark.timeout(3000)
@pytest.mark.parametrize("how", [{}, {"tares": True}, {"gaps": True}], ids=" ".join)
def test_presses_in_any_order_leave_no_wrong_reading_without_a_flag(how, long_run):
    wrong, steady, unflagged = [], 0, 0
    for seed in range(LONG_SEEDS if long_run else SEEDS):
        sequence = Sequence(seed, **how)
        wrong += [f"seed {seed}: {text}" for text in sequence.wrong]
        steady += sequence.counts["steady touches"]
        unflagged += sequence.counts["unflagged steady touches"]
    assert len(wrong) <= _BY_NOISE * unflagged, "\n".join([*wrong[:10], f"{len(wrong)} readings"])
    assert unflagged > 0.2 * steady
