# SPDX-License-Identifier: GPL-3.0-or-later
"""Base of the Python blocks of the chain: an item per phase group, its state as a tag."""

import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
import pmt
from gnuradio import gr

from ...estimation.groups import Array, Groups
from ...wiforce_python import input_has_ended
from .. import names
from ..kept import Kept
from . import state_tag

# Tags of each item, by name.
Tags = Sequence[dict[str, Any]]

_STATE = pmt.intern(names.STATE)
_DONE = -1
_NOTHING = Groups(np.zeros(0, np.int64))
_PAGE_BYTES, _LEAST_GROUPS = 4096, 32


class GroupBlock(Kept, gr.basic_block):
    """Passes the groups that have arrived to ``take``, and sends the groups that it returns.

    Subclasses implement ``take(items, tags)``, with ``items`` the input's vectors and ``tags`` a
    dict of tags by name for each, and return how many items were taken and a Groups, the rows of
    which ``vectors(groups)`` turns into items. Once the input has ended, ``flush()`` gives the
    groups that were held back: they are the last items of the output, so the next block has read
    them before it flushes its own.

    An exception in ``take``, or one that a message handler passes to ``fail``, ends the flowgraph
    in order; raised through the scheduler it would hang or abort the process.

    Parameters
    ----------
    name : str
        Of the block.
    inputs, outputs : int
        Lengths of the vectors; 0 outputs for a sink.

    Attributes
    ----------
    failure : Exception or None
        The error that ended the flowgraph.

    Examples
    --------
    >>> class Counter(GroupBlock):
    ...     def take(self, items, tags):
    ...         return len(items), Groups([])
    >>> Counter("counter", inputs=2, outputs=0).failure is None
    True
    """

    def __init__(self, name: str, inputs: int, outputs: int) -> None:
        out_sig = [(np.complex64, outputs)] if outputs else None
        gr.basic_block.__init__(self, name, in_sig=[(np.complex64, inputs)], out_sig=out_sig)
        self.set_tag_propagation_policy(gr.TPP_DONT)
        if outputs:
            self.set_max_output_buffer(_buffered_groups(self.output_signature()))
        self._ready: deque[tuple[Groups, Array]] = deque()
        self.failure: Exception | None = None
        self._sends, self._flushed = bool(outputs), False

    def take(self, items: Array, tags: Tags) -> tuple[int, Groups]:
        """Process items (G, n); return how many were taken and the groups that are ready."""
        raise NotImplementedError

    def flush(self) -> Groups:
        """Give the groups that are held back at the end of the input; none by default."""
        return _NOTHING

    def vectors(self, groups: Groups) -> Array:
        """Items (G, n) of a batch."""
        raise NotImplementedError

    def fail(self, error: Exception) -> None:
        """End the flowgraph with an exception."""
        self.failure = error
        gr.log.error(f"{self.name()}: {type(error).__name__}: {error}")

    def start(self) -> bool:
        self._flushed = False
        return True

    def forecast(self, noutput_items: int, ninputs: int) -> list[int]:
        # A block that needs input is not called any more when its input has ended.
        needed = 0 if self._ready or self._must_flush() else 1
        return [needed] * ninputs

    def general_work(self, input_items: list[Array], output_items: list[Array]) -> int:
        if self.failure is not None or self._flushed and not self._ready:
            return _DONE
        room = len(output_items[0]) if self._sends else 0
        produced, consumed = self._put_out(output_items, 0, room), 0
        if not self._sends or produced < room:
            try:
                consumed, groups = self._next(input_items[0])
                rows = self.vectors(groups) if self._sends and len(groups) else ()
            except Exception as error:
                self.fail(error)
                return _DONE
            self._ready.extend((groups[i : i + 1], row) for i, row in enumerate(rows))
            produced = self._put_out(output_items, produced, room)
        self.consume(0, consumed)
        return produced

    def _next(self, items: Array) -> tuple[int, Groups]:
        """Take the items; when all are taken and the input has ended, flush."""
        if len(items) and not self._flushed:
            return self.take(items, self._tags_of(len(items)))
        if not self._must_flush():
            return 0, _NOTHING
        self._flushed = True
        return 0, self.flush()

    def _must_flush(self) -> bool:
        return not self._flushed and input_has_ended(self.gateway)

    def _tags_of(self, count: int) -> Tags:
        tags: list[dict[str, Any]] = [{} for _ in range(count)]
        first = self.nitems_read(0)
        for tag in self.get_tags_in_range(0, first, first + count):
            tags[tag.offset - first][pmt.symbol_to_string(tag.key)] = tag.value
        return tags

    def _put_out(self, output_items: list[Array], produced: int, room: int) -> int:
        while self._ready and produced < room:
            group, vector = self._ready.popleft()
            output_items[0][produced] = vector
            offset = self.nitems_written(0) + produced
            self.add_item_tag(0, offset, _STATE, state_tag.to_pmt(group))
            produced += 1
        return produced


def _buffered_groups(signature: Any) -> int:
    """Length of a short buffer of whole pages.

    GNU Radio keeps the tags of as many items as a buffer holds, which would be minutes of groups.
    """
    size = signature.sizeof_stream_item(0)
    in_pages = math.lcm(size, _PAGE_BYTES) // size
    return in_pages * math.ceil(_LEAST_GROUPS / in_pages)


def groups_of(tags: Tags) -> Groups:
    """The batch that the previous stage described in tags.

    Parameters
    ----------
    tags : sequence of dict
        Of each item, by name.

    Returns
    -------
    Groups

    Raises
    ------
    RuntimeError
        When an item has no state: the block is not connected after ``end_separation``.

    Examples
    --------
    >>> state = state_tag.to_pmt(Groups([7]))
    >>> groups_of([{names.STATE: state}]).index.tolist()
    [7]
    """
    if any(names.STATE not in own for own in tags):
        raise RuntimeError(f"group without a {names.STATE!r} tag: connect after end_separation")
    return Groups.concatenate(state_tag.from_pmt(own[names.STATE]) for own in tags)


def count_of(tags: dict[str, Any], name: str) -> int:
    """Value of a tag that counts, 0 where an item has none.

    Parameters
    ----------
    tags : dict
        Of one item, by name.
    name : str

    Returns
    -------
    int

    Examples
    --------
    >>> count_of({"missing": pmt.from_uint64(3)}, "missing"), count_of({}, "missing")
    (3, 0)
    """
    return int(pmt.to_uint64(tags[name])) if name in tags else 0
