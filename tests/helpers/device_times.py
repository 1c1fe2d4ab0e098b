# SPDX-License-Identifier: GPL-3.0-or-later
"""A device's times as tags of a stream, and values that are none."""

import pmt
from gnuradio import gr
from gnuradio.wiforce.blocks.stream_watch import time_value


def tag_at(item, key, value):
    """Tag of an item, by the name of its key."""
    return gr.tag_utils.python_to_tag((item, pmt.intern(key), value, pmt.PMT_F))


def value(seconds):
    """What a tag says of a time in seconds."""
    whole = int(seconds % 1e15)  # what is beyond goes to the fraction, which cannot be so large
    return time_value(whole, seconds - whole)


def rx_time(offset, seconds):
    """Tag of an item."""
    return tag_at(offset, "rx_time", value(seconds))


# What must not be taken for 2 s and a half.
NO_TIMES = {
    "number": pmt.from_double(2.5),
    "nothing": pmt.PMT_NIL,
    "pair": pmt.cons(pmt.from_uint64(2), pmt.from_double(0.5)),
    "vector": pmt.make_vector(2, pmt.from_double(2.5)),
    "whole seconds only": pmt.make_tuple(pmt.from_uint64(2)),
    "three parts": pmt.make_tuple(pmt.from_uint64(2), pmt.from_double(0.5), pmt.from_uint64(0)),
    "real seconds": pmt.make_tuple(pmt.from_double(2.0), pmt.from_double(0.5)),
    "negative seconds": pmt.make_tuple(pmt.from_long(-2), pmt.from_double(0.5)),
    "integer fraction": pmt.make_tuple(pmt.from_uint64(2), pmt.from_long(1)),
    "fraction that is no number": time_value(2, float("nan")),
    "negative fraction": time_value(2, -0.5),
}
