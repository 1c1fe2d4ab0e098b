# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of the interpreter for a process that must react within milliseconds."""

import gc
import sys

# Time after which a thread that computes gives way to one that has received something. Python's
# own 5 ms are longer than the whole processing of a group.
_SWITCH_S = 0.5e-3


def shorten_pauses() -> None:
    """Shorten the pauses that Python makes; called once, when everything is loaded.

    Objects that exist now are left out of later garbage collections. Going through the modules
    takes a tenth of a second, during which no reading is given.
    """
    gc.collect()
    gc.freeze()
    sys.setswitchinterval(_SWITCH_S)
