# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that runs one task: a pickled function and its argument in, a pickled outcome out."""

import os
import pickle
import sys


def outcome_of(function, task):
    """Call a function and return what can be sent to another process, whatever happens.

    Parameters
    ----------
    function : callable
    task : object
        Its argument.

    Returns
    -------
    kind : str
        ``result`` or ``error``.
    value : object
        What the function returned, or the exception that it raised.
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


def main():
    """Read the task from standard input and write its outcome to standard output."""
    with os.fdopen(os.dup(1), "wb") as answer:
        os.dup2(2, 1)  # what libraries print must not mix with the outcome
        answer.write(pickle.dumps(outcome_of(*pickle.load(sys.stdin.buffer))))


if __name__ == "__main__":
    main()
