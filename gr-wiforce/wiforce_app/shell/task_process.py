# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that runs one task: a pickled function and its argument in, a pickled outcome out."""

import contextlib
import os
import pickle
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable

# For a process that was asked to end: what it removes are files.
END_S = 1.0
_TERMINATED = 128 + signal.SIGTERM


def outcome_of(function, task):
    """Call a function and return what can be sent to another process, whatever happens.

    Returns kind: ``result`` or ``error``; value: what the function returned, or the exception that
    it raised.
    """
    try:
        return "result", function(task)
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            # An exception whose constructor takes something else than its text.
            return "error", RuntimeError(f"{type(error).__name__}: {error}")
        return "error", error


def end_with(gone: Callable[[], object]) -> None:
    """End this process when the one that it works for has ended.

    It ends by SIGTERM as well. In both cases it removes what it has not completed.

    ``gone``: returns when the other process has ended.
    """

    def watch():
        gone()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(END_S)
        os._exit(_TERMINATED)

    # Nothing is to be removed yet, and an exception here would be printed.
    signal.signal(signal.SIGTERM, lambda *_: os._exit(_TERMINATED))
    threading.Thread(target=watch, daemon=True).start()
    signal.signal(signal.SIGTERM, _end)


def _end(*_):
    # Python prints a traceback of any other exception that ends a process.
    raise SystemExit(_TERMINATED)


def run_in_child(payload: bytes) -> tuple[int, bytes, bytes]:
    """Run a task in a process of its own, which ends with this one.

    Returns status: exit status of the process; answer: the pickled outcome, where the status is 0;
    errors: what it has printed. ``payload``: pickled function and argument.
    """
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    command = [sys.executable, "-m", __spec__.name]
    pipe = subprocess.PIPE
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(
            command, bufsize=0, stdin=pipe, stdout=pipe, stderr=errors, env=environment
        ) as child,
    ):
        assert child.stdin is not None and child.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # it has ended, with a status
            child.stdin.write(payload)
        # Its input stays open meanwhile, and is closed when this process is killed.
        answer, status = child.stdout.read(), child.wait()
        errors.seek(0)
        return status, answer, errors.read()


def main():
    """Read the task from standard input and write its outcome to standard output."""
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)  # what libraries print must not mix with the outcome
        task = pickle.load(sys.stdin.buffer)
        end_with(lambda: os.read(0, 1))
        answer.write(pickle.dumps(outcome_of(*task)))


if __name__ == "__main__":
    main()
