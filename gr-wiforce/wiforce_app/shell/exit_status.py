# SPDX-License-Identifier: GPL-3.0-or-later
"""Exit statuses of the command, which docs and the epilog of ``--help`` list.

Examples
--------
>>> FAILED, BAD_INPUT
(1, 2)
"""

DONE = 0
# Any failure that is not the user's: a full disk, a lost device, a fault of the program.
FAILED = 1
# Bad usage or bad input, explained in one line.
BAD_INPUT = 2
# 128 + the number of the signal, as a shell reports a process that a signal ended. SIGPIPE itself
# stays ignored: it would leave a transmitter on and a file incomplete.
INTERRUPTED, TERMINATED, OUTPUT_CLOSED = 130, 143, 141
