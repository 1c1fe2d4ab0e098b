# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene needs computed, what that costs, which errors to expect, and what to improve.

`plan` computes all settings of the receiver from a scene, once: the clutter band, the lines that
are used and what they lose (`loss`). `expected` gives the errors of readings, `steps` what is
computed and what it costs, and `advice` warns and proposes changes. `clocks` are those of tags, and
`adaptation` is to a room, whose survey `findings` puts into words.
"""
