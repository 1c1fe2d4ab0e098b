# SPDX-License-Identifier: GPL-3.0-or-later
"""A device's times as tags of a stream, and values that are none."""

import pmt
from gnuradio import gr
from gnuradio.wiforce.stream_time import time_value

KEY = pmt.intern("rx_time")


def value(seconds):
    """What a tag says of a time in seconds."""
    whole = int(seconds % 1e15)  # what is beyond goes to the fraction, which cannot be so large
    return time_value(whole, seconds - whole)


def rx_time(offset, seconds):
    """Tag of an item."""
    return gr.tag_utils.python_to_tag((offset, KEY, value(seconds), pmt.PMT_F))
