# SPDX-License-Identifier: GPL-3.0-or-later
"""What the Python blocks of the chain share: an item per phase group, its state as a tag."""

import math
from collections import deque

import numpy as np
import pmt
from gnuradio import gr

from .. import names
from ..estimation.groups import Groups
from . import state_tag

_STATE = pmt.intern(names.STATE)
_DONE = -1
_PAGE_BYTES, _LEAST_GROUPS = 4096, 32


class GroupBlock(gr.basic_block):
    """Hands the groups that have arrived to ``take``, and sends what it returns.

    Subclasses implement ``take(items, tags)``, with ``items`` the input's vectors and ``tags`` a
    dict of tags by name for each, and return how many items were taken and a Groups, the rows of
    which ``vectors(groups)`` turns into items.

    An exception in ``take``, or one that a message handler hands to ``fail``, ends the flowgraph
    in good order: raised through the scheduler it would hang or abort the process.

    Parameters
    ----------
    name : str
    inputs, outputs : int
        Lengths of the vectors; 0 outputs for a sink.

    Attributes
    ----------
    failure : Exception or None
        What ended the flowgraph.
    """

    def __init__(self, name, inputs, outputs):
        out_sig = [(np.complex64, outputs)] if outputs else None
        gr.basic_block.__init__(self, name, in_sig=[(np.complex64, inputs)], out_sig=out_sig)
        self.set_tag_propagation_policy(gr.TPP_DONT)
        if outputs:
            self.set_max_output_buffer(_buffered_groups(self.output_signature()))
        self._ready = deque()
        self.failure = None
        self._sends = bool(outputs)

    def take(self, items, tags):
        raise NotImplementedError

    def vectors(self, groups):
        """Items (G, n) of a batch."""
        raise NotImplementedError

    def fail(self, error):
        """End the flowgraph with an exception."""
        self.failure = error
        gr.log.error(f"{self.name()}: {type(error).__name__}: {error}")

    def forecast(self, noutput_items, ninputs):
        return [0 if self._ready else 1] * ninputs

    def general_work(self, input_items, output_items):
        if self.failure is not None:
            return _DONE
        room = len(output_items[0]) if self._sends else 0
        produced = self._put_out(output_items, 0, room)
        items = input_items[0]
        if self._sends and produced == room or not len(items):
            self.consume(0, 0)
            return produced
        try:
            consumed, groups = self.take(items, self._tags_of(len(items)))
        except Exception as error:
            self.fail(error)
            return _DONE
        if self._sends and len(groups):
            rows = self.vectors(groups)
            self._ready.extend((groups[i : i + 1], row) for i, row in enumerate(rows))
            produced = self._put_out(output_items, produced, room)
        self.consume(0, consumed)
        return produced

    def _tags_of(self, count):
        tags = [{} for _ in range(count)]
        first = self.nitems_read(0)
        for tag in self.get_tags_in_range(0, first, first + count):
            tags[tag.offset - first][pmt.symbol_to_string(tag.key)] = tag.value
        return tags

    def _put_out(self, output_items, produced, room):
        while self._ready and produced < room:
            group, vector = self._ready.popleft()
            output_items[0][produced] = vector
            offset = self.nitems_written(0) + produced
            self.add_item_tag(0, offset, _STATE, state_tag.to_pmt(group))
            produced += 1
        return produced


def _buffered_groups(signature):
    """Length of a short buffer of whole pages.

    GNU Radio keeps the tags of as many items as a buffer holds, which would be minutes of groups.
    """
    size = signature.sizeof_stream_item(0)
    in_pages = math.lcm(size, _PAGE_BYTES) // size
    return in_pages * math.ceil(_LEAST_GROUPS / in_pages)


def groups_of(tags):
    """The batch that a stage before described in tags, a dict for each item.

    Raises
    ------
    RuntimeError
        When an item has none: the block is not connected behind its chain.
    """
    if any(names.STATE not in own for own in tags):
        raise RuntimeError(f"group without a {names.STATE!r} tag: connect behind end_separation")
    return Groups.concatenate(state_tag.from_pmt(own[names.STATE]) for own in tags)
