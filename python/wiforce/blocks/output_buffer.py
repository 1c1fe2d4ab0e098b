# SPDX-License-Identifier: GPL-3.0-or-later
"""Sizes of output buffers."""

from typing import Any


def enlarge_output_buffer(block: Any, items: int) -> None:
    """Call ``set_min_output_buffer`` without the line that it prints.

    Parameters
    ----------
    block : gr.block
    items : int
        Least length of the buffer.

    Examples
    --------
    >>> from gnuradio import blocks
    >>> head = blocks.head(8, 1000)
    >>> enlarge_output_buffer(head, 4096)
    >>> head.min_output_buffer(0)
    4096
    """
    level = block.log_level()
    block.set_log_level("warn")
    block.set_min_output_buffer(items)
    block.set_log_level(level)
