# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce read`` and ``export``: recordings to files of readings, and these to other formats.

`recordings` opens recordings and warns of what they lack, for all commands. `read_one` reads one,
also while it grows (`follow`). `read_many` reads any number in parallel, notes the finished ones
and joins their readings.
"""
