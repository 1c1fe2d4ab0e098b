# SPDX-License-Identifier: GPL-3.0-or-later
"""Interruptions: Ctrl-C and SIGTERM end a command by an exception, so that it can clean up."""

import signal


class Terminated(KeyboardInterrupt):
    """SIGTERM was received; handled like Ctrl-C except for the exit status."""


class Interrupted(Exception):
    """A command was interrupted after it had written something.

    Parameters
    ----------
    partial : str
        What has been written, for the message.
    """


def terminate_by_exception():
    """Let SIGTERM raise :class:`Terminated` in the main thread, instead of ending the process.

    A second SIGTERM ends the process at once.
    """

    def terminate(*_):
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        raise Terminated

    signal.signal(signal.SIGTERM, terminate)
