# SPDX-License-Identifier: GPL-3.0-or-later
"""What the Python blocks of the chain share: one item per phase group, its state as a tag."""

import math
from collections import deque

import numpy as np
import pmt
from gnuradio import gr

from .. import names
from . import state_tag

_STATE = pmt.intern(names.STATE)
_DONE = -1
_PAGE_BYTES, _LEAST_GROUPS = 4096, 32


class GroupBlock(gr.basic_block):
    """Hands each group with its tags to ``take``, and puts out what that gives when it gives it.

    Subclasses implement ``take(tags, item)``, with ``tags`` a dict of the item's tags by name and
    ``item`` a complex64 vector, and return a list of (GroupState, vector), or None to leave the
    item in the stream for now.

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

    def take(self, tags, item):
        raise NotImplementedError

    def fail(self, error):
        """Ends the flowgraph with an exception."""
        self.failure = error
        gr.log.error(f"{self.name()}: {type(error).__name__}: {error}")

    def forecast(self, noutput_items, ninputs):
        return [0 if self._ready else 1] * ninputs

    def general_work(self, input_items, output_items):
        if self.failure is not None:
            return _DONE
        items = input_items[0]
        room = len(output_items[0]) if self._sends else len(items)
        produced = self._put_out(output_items, 0, room)
        first = self.nitems_read(0)
        consumed = 0
        # One group at a time, so that a group that is not ready to be taken stays in the stream.
        while consumed < len(items) and produced < room:
            tags = {
                pmt.symbol_to_string(tag.key): tag.value
                for tag in self.get_tags_in_range(0, first + consumed, first + consumed + 1)
            }
            try:
                results = self.take(tags, items[consumed])
            except Exception as error:
                self.fail(error)
                return _DONE
            if results is None:
                break
            consumed += 1
            self._ready.extend(results)
            produced = self._put_out(output_items, produced, room) if self._sends else 0
        self.consume(0, consumed)
        return produced

    def _put_out(self, output_items, produced, room):
        while self._ready and produced < room:
            state, vector = self._ready.popleft()
            output_items[0][produced] = vector
            offset = self.nitems_written(0) + produced
            self.add_item_tag(0, offset, _STATE, state_tag.to_pmt(state))
            produced += 1
        return produced


def _buffered_groups(signature):
    """Length of a short buffer of whole pages.

    GNU Radio keeps the tags of as many items as a buffer holds, which would be minutes of groups.
    """
    size = signature.sizeof_stream_item(0)
    in_pages = math.lcm(size, _PAGE_BYTES) // size
    return in_pages * math.ceil(_LEAST_GROUPS / in_pages)


def state_of(tags):
    """The GroupState among an item's tags.

    Raises
    ------
    RuntimeError
        When the item has none: the block is not connected behind its chain.
    """
    if names.STATE not in tags:
        raise RuntimeError(f"group without a {names.STATE!r} tag: connect behind end_separation")
    return state_tag.from_pmt(tags[names.STATE])
