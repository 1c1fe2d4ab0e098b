# SPDX-License-Identifier: GPL-3.0-or-later
"""Python blocks that live as long as the flowgraph that they are connected to."""

from typing import Any

from ..wiforce_python import kept_with


class Kept:
    """Mix-in of Python blocks, before GNU Radio's class, that a flowgraph keeps.

    GNU Radio's flowgraphs hold only the C++ part of a Python block. Without this, a block that no
    variable refers to is destroyed while it runs, which ends the process.

    Examples
    --------
    >>> import weakref
    >>> from gnuradio import blocks, gr
    >>> class Sink(Kept, gr.sync_block):
    ...     def __init__(self):
    ...         gr.sync_block.__init__(self, "sink", in_sig=["c8"], out_sig=None)
    >>> flowgraph, sink = gr.top_block(), Sink()
    >>> there = weakref.ref(sink)
    >>> flowgraph.connect(blocks.null_source(8), sink)
    >>> del sink
    >>> there() is None
    False
    >>> del flowgraph
    >>> there() is None
    True
    """

    def to_basic_block(self) -> Any:
        """The block as a flowgraph connects it."""
        # The C++ part of a hierarchical block, and that of another one.
        own = self.__dict__
        return kept_with(own["_impl"] if "_impl" in own else own["gateway"], self)
