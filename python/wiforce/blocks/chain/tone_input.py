# SPDX-License-Identifier: GPL-3.0-or-later
"""Vectors of tones with their tags and messages, as a batch of groups."""

from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ...estimation.capture.folded_groups import FoldedGroups
from ...estimation.groups import Array, Groups, is_clipped
from ...planning.plan import Plan
from .. import names
from .group_block import Tags, count_of
from .subcarriers import occupied_subcarriers


class ToneInput:
    """Converts the output of ``ofdm_channel_estimator`` to Groups.

    Parameters
    ----------
    plan : Plan
        Of a scene: ``wiforce.plan(scene)``.
    derotated : bool
        Whether the channel estimator was given the plan's derotation.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> count, groups = ToneInput(wiforce.plan("demo")).collect(
    ...     np.zeros((1, 24 * 64)), [{names.GROUP: pmt.from_uint64(7)}])
    >>> count, groups.index.tolist(), groups.tones.shape
    (1, [7], (1, 24, 62))
    """

    def __init__(self, plan: Plan, derotated: bool = True) -> None:
        self._plan = plan
        self.rows = len(plan.table.tones)
        self._folded = FoldedGroups(plan.table, plan.waveform, derotated)
        self._messages: dict[int, tuple[Array, Array]] = {}
        self._expected: int | None = None

    def on_incomplete(self, message: Any) -> None:
        """Take the snapshots of a group with gaps (message port ``incomplete``)."""
        meta = pmt.to_python(pmt.car(message))
        present = np.asarray(meta[names.MASK], bool)
        folded = np.array(pmt.c32vector_elements(pmt.cdr(message)), complex)
        self._messages[int(meta[names.GROUP])] = (present, folded.reshape(len(present), -1))

    def collect(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        """Collect a batch of items whose messages have arrived.

        Parameters
        ----------
        items : ndarray of complex, shape (G, N M)
            Vectors of tones.
        tags : sequence of dict
            Of each item, by name.

        Returns
        -------
        int
            Items taken.
        Groups
        """
        plan = self._plan
        group_length = plan.group_length
        index = np.array([pmt.to_uint64(own[names.GROUP]) for own in tags], np.int64)
        missing = np.array([count_of(own, names.MISSING) for own in tags])
        saturated = np.array([count_of(own, names.SATURATED) for own in tags])
        tones = occupied_subcarriers(items, self.rows, plan.waveform.bins)
        rejected = np.array([count_of(own, names.REJECTED) for own in tags])
        incomplete = missing + rejected > 0
        weights = np.ones((len(index), group_length), bool)
        count = len(index)
        for row in np.flatnonzero(incomplete):
            group = int(index[row])
            if group not in self._messages and self._expected != group:
                # Its snapshots were sent before it: wait until the messages have been handled.
                self._expected = group
                count = row
                break
            tones[row], _, weights[row] = self._solved(group)
            if not weights[row].any():
                missing[row] = group_length
        groups = Groups(
            index[:count],
            tones[:count],
            missing[:count],
            is_clipped(saturated[:count], group_length),
            np.array([names.RETUNED in own for own in tags[:count]], bool),
            weights[:count] if incomplete.any() else None,
            rejected[:count] / group_length,
        )
        return count, groups

    def _solved(self, group: int) -> tuple[Array | float, ...]:
        """Tones of a group with gaps and the weights of its snapshots; zeros when not solvable."""
        if group not in self._messages:
            gr.log.warn(
                f"end_separation: no snapshots of group {group} arrived, it is flagged 'gap': "
                "connect the message port 'incomplete'"
            )
            return 0.0, 0.0, 0.0
        present, folded = self._messages.pop(group)
        return self._folded.solve(present, folded[present])
