# SPDX-License-Identifier: GPL-3.0-or-later
"""Vectors of tones with their tags and messages, as a batch of groups."""

import numpy as np
import pmt
from gnuradio import gr

from .. import names
from ..estimation.folded_groups import FoldedGroups
from ..estimation.groups import Groups, is_clipped
from .group_block import GroupBlock


class ToneInput:
    """Makes Groups of what ``ofdm_channel_estimator`` sends behind the tones.

    Parameters
    ----------
    plan : Plan
    derotated : bool
        Whether the channel estimator was given the plan's derotation.
    """

    def __init__(self, plan, derotated=True):
        self._plan = plan
        self.rows = len(plan.table.tones)
        self._folded = FoldedGroups(plan.table, plan.waveform, derotated)
        self._messages = {}
        self._expected = None

    def on_incomplete(self, message):
        """Take the snapshots of a group with gaps (message port ``incomplete``)."""
        meta = pmt.to_python(pmt.car(message))
        present = np.asarray(meta[names.MASK], bool)
        folded = np.array(pmt.c32vector_elements(pmt.cdr(message)), complex)
        self._messages[int(meta[names.GROUP])] = (present, folded.reshape(len(present), 64))

    def collect(self, items, tags):
        """A batch of the items, as far as the messages that belong to them have come.

        Returns
        -------
        int
            Items taken.
        Groups
        """
        plan = self._plan
        group_length = plan.group_length
        index = np.array([pmt.to_uint64(own[names.GROUP]) for own in tags], np.int64)
        missing = np.array([_count(own, names.MISSING) for own in tags])
        saturated = np.array([_count(own, names.SATURATED) for own in tags])
        tones = items.reshape(-1, self.rows, 64)[:, :, plan.waveform.bins].astype(complex)
        weights = np.ones((len(index), group_length), bool) if missing.any() else None
        count = len(index)
        for row in np.flatnonzero(missing):
            group = int(index[row])
            if group not in self._messages and self._expected != group:
                # Its snapshots were sent before it: it waits until messages have been handled.
                self._expected = group
                count = row
                break
            tones[row], weights[row] = self._solved(group)
        groups = Groups(
            index[:count],
            tones[:count],
            missing[:count],
            is_clipped(saturated[:count], group_length),
            np.array([names.RETUNED in own for own in tags[:count]], bool),
            None if weights is None else weights[:count],
        )
        return count, groups

    def _solved(self, group):
        """Tones of a group with gaps and the weights of its snapshots; zeros when not solvable."""
        if group not in self._messages:
            gr.log.warn(
                f"end_separation: no snapshots of group {group} arrived, it is flagged 'gap': "
                "connect the message port 'incomplete'"
            )
            return 0.0, 0.0
        present, folded = self._messages.pop(group)
        return self._folded.solve(present, folded[present])


class ToneBlock(GroupBlock):
    """A block behind the channel estimator, with the port ``incomplete``.

    Subclasses implement ``process``, which takes a batch of Groups with tones and returns one.

    Parameters
    ----------
    name : str
    plan : Plan
    derotated : bool
        Whether the channel estimator was given the plan's derotation.
    outputs : int
        Length of the vectors; 0 for a sink.
    """

    def __init__(self, name, plan, derotated, outputs):
        self._input = ToneInput(plan, derotated)
        GroupBlock.__init__(self, name, self._input.rows * 64, outputs)
        self.message_port_register_in(pmt.intern(names.INCOMPLETE))
        self.set_msg_handler(pmt.intern(names.INCOMPLETE), self._on_incomplete)

    def _on_incomplete(self, message):
        try:
            self._input.on_incomplete(message)
        except Exception as error:
            self.fail(error)

    def process(self, groups):
        raise NotImplementedError

    def take(self, items, tags):
        count, groups = self._input.collect(items, tags)
        return count, self.process(groups)


def _count(tags, name):
    return pmt.to_uint64(tags[name]) if name in tags else 0
