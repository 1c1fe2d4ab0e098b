# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts flowgraphs of devices whose drivers may refuse to stream, or never answer."""

import functools
import os
import re
import threading
import time
from collections.abc import Callable

from gnuradio import gr

from .request import DeviceUnusable

# Drivers start a stream within a second or two, by the documentation of their modules.
_LIMIT_S = 20.0
_LOOK_S = 0.02
_MOST_LOG_BYTES = 1 << 16
# What GNU Radio logs when a block's thread ends with an exception (thread_body_wrapper.h).
_FAILURE = re.compile(r"ERROR thread\[thread-per-block\[\d+\]: <block [^>]*>\]: ?([^\n]*)")


def start_flowgraph(
    flowgraph: gr.top_block,
    stopped: Callable[[], bool],
    option: str,
    args: str,
    limit_s: float = _LIMIT_S,
) -> None:
    """Start a flowgraph, in bounded time.

    GNU Radio starts each block in a thread of its own, and waits until all of them have started.
    The thread of a block that throws while it starts ends before, so that GNU Radio waits for ever.
    It tells the cause to its log only.

    ``stopped``: whether to give up; ``option``, ``args``: name the device, for the message;
    ``limit_s``: how long to wait for the driver. Raises DeviceUnusable when a block does not start.
    The flowgraph can neither be stopped nor freed then.
    """
    started, errors = threading.Event(), []

    def start():
        try:
            flowgraph.start()
        except Exception as error:
            errors.append(error)
        started.set()

    with _ErrorLog() as error_log:
        threading.Thread(target=start, daemon=True).start()
        deadline = time.monotonic() + limit_s
        while not started.wait(_LOOK_S):
            reason = error_log.failure()
            if reason is None and time.monotonic() > deadline:
                reason = f"its driver has not started to stream within {limit_s:g} s"
            if reason is None and stopped():
                reason = "stopped before its driver started to stream"
            if reason is not None:
                rule = f"must name a device that can stream ({reason})"
                raise DeviceUnusable(option, rule, args)
    if errors:
        raise errors[0]


class _ErrorLog:
    """Keeps the errors that GNU Radio logs to standard output meanwhile; shows nothing else."""

    def __enter__(self):
        _log_to_standard_output()
        self._kept, self._file = os.dup(1), os.memfd_create("errors")
        os.dup2(self._file, 1)
        self._level = gr.logging().default_level()
        gr.logging().set_default_level(gr.log_levels.err)
        return self

    def __exit__(self, *_):
        gr.logging().set_default_level(self._level)
        os.dup2(self._kept, 1)
        os.close(self._kept)
        os.close(self._file)

    def failure(self):
        """Why a block's thread has ended; None while none has."""
        text = os.pread(self._file, _MOST_LOG_BYTES, 0).decode(errors="backslashreplace")
        found = _FAILURE.search(text)
        return None if found is None else found[1].strip() or "without a reason"


@functools.cache
def _log_to_standard_output():
    # GNU Radio's own configuration may send its log elsewhere.
    gr.logging().add_default_console_sink()
