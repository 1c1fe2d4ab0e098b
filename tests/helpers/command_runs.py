# SPDX-License-Identifier: GPL-3.0-or-later
"""The ``gr-wiforce`` command, run inside the process of the tests.

A process of its own takes half a second of processor time to import the package. Only tests of a
process start one: of signals, standard streams, limits, imports and live runs.
"""

import csv
import os
import subprocess
import sys
import tempfile
import warnings
from contextlib import ExitStack, chdir, contextmanager

from machine import wait_until
from wiforce_app import main
from wiforce_app.shell.log import log


@contextmanager
def _redirected(name):
    """The file that replaces a standard stream, of Python and of libraries in C++."""
    stream = getattr(sys, name)
    number = {"stdout": 1, "stderr": 2}[name]
    stream.flush()
    kept = os.dup(number)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), number)
        replaced = open(number, "w", encoding="utf-8", errors="backslashreplace", closefd=False)
        setattr(sys, name, replaced)
        try:
            yield file
        finally:
            replaced.flush()
            setattr(sys, name, stream)
            os.dup2(kept, number)
            os.close(kept)


def _text(file):
    file.seek(0)
    return file.read().decode()


def run_command(*arguments, cwd="."):
    """Run the command as its entry function does.

    Returns subprocess.CompletedProcess: with ``returncode``, ``stdout`` and ``stderr`` as text.
    ``*arguments``: arguments of the command, converted to strings; ``cwd``: folder in which it
    runs.
    """
    words = [str(argument) for argument in arguments]
    with ExitStack() as conditions:
        conditions.enter_context(chdir(cwd))
        conditions.enter_context(warnings.catch_warnings())
        warnings.simplefilter("ignore")
        output, errors = (conditions.enter_context(_redirected(n)) for n in ("stdout", "stderr"))
        log.set_up()
        status = main.main(words)
        sys.stdout.flush()
        sys.stderr.flush()
        return subprocess.CompletedProcess(words, status, _text(output), _text(errors))


def succeeded(*arguments, cwd="."):
    """What `run_command` returns of a command that must succeed."""
    done = run_command(*arguments, cwd=cwd)
    assert done.returncode == 0, done.stdout + done.stderr
    return done


def refused(*arguments, cwd="."):
    """The one line with which the command refuses its input or options, by status 2."""
    done = run_command(*arguments, cwd=cwd)
    assert (done.returncode, done.stdout) == (2, ""), done.stdout + done.stderr
    (line,) = done.stderr.splitlines()
    return line


def ended_by(number, begun, *arguments):
    """Exit status and messages of a process of the command that gets a signal when it has begun."""
    words = ["gr-wiforce", *map(str, arguments)]
    with subprocess.Popen(words, stderr=subprocess.PIPE, text=True) as process:
        wait_until(begun, pause_s=5e-3, process=process)
        process.send_signal(number)
        said = process.communicate(timeout=300)[1]
    return process.returncode, said


def rows_of(*paths):
    """Rows of tables, as of readings or of the truth, by the names of their columns."""
    rows = []
    for path in paths:
        with open(path, newline="", encoding="utf-8") as stream:
            rows += csv.DictReader(stream)
    return rows
