# SPDX-License-Identifier: GPL-3.0-or-later
"""Ctrl-C and SIGTERM: where they may end a command, and where files come first."""

import os
import signal
import subprocess

import pytest
from gnuradio.wiforce.errors import OutputError
from gnuradio.wiforce.io.outputs import Output
from wiforce_app.read.read_one import FileOutputs
from wiforce_app.shell.interrupts import Terminated, interrupt_by_exception, uninterrupted

INTERRUPTIONS = [(signal.SIGINT, KeyboardInterrupt), (signal.SIGTERM, Terminated)]


@pytest.fixture(autouse=True)
def handlers():
    """Those of the command; afterwards those of pytest."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    kept = {number: signal.getsignal(number) for number in numbers}
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    interrupt_by_exception()
    yield
    for number, handler in kept.items():
        signal.signal(number, handler)


class Rows(Output):
    """An output that is interrupted, or fails, while it is written to or ended."""

    def __init__(self, *signals, failure=None):
        self.rows, self.closed = 0, False
        self._signals, self._failure = signals, failure

    def close(self):
        self.closed = True

    def write_rows(self, rows):
        for number in self._signals:
            os.kill(os.getpid(), number)
        if self._failure is not None:
            raise self._failure
        self.rows += 1


@pytest.mark.parametrize("number, expected", INTERRUPTIONS)
def test_interruption_of_a_row_waits_until_it_is_in_all_files(number, expected):
    """MCAP lost all rows of its last chunk, while the CSV beside it had them."""
    first, second = Rows(number), Rows()
    with pytest.raises(expected) as found, FileOutputs(first, second) as outputs:
        outputs.write_all([])
    assert found.type is expected
    assert (first.rows, second.rows) == (1, 1) and first.closed and second.closed


def test_closed_terminal_ends_a_command_once_as_sigterm_does():
    """It left half a simulation in a hidden folder, and a Parquet file without its end."""
    first = Rows(signal.SIGHUP, signal.SIGHUP)
    with pytest.raises(Terminated), FileOutputs(first) as outputs:
        outputs.write_all([])
    assert first.rows == 1 and first.closed


def test_interruption_does_not_hide_that_a_file_is_full():
    full = Rows(signal.SIGINT, failure=OutputError("out.csv", "disk full"))
    second = Rows()
    with pytest.raises(OutputError, match="disk full"), FileOutputs(full, second) as outputs:
        outputs.write_all([])
    assert second.rows == 1
    with uninterrupted():
        pass  # nothing waits any more


def test_interruption_of_nested_blocks_waits_for_the_outermost():
    done = []
    with pytest.raises(KeyboardInterrupt), uninterrupted():
        with uninterrupted():
            os.kill(os.getpid(), signal.SIGINT)
        done.append("outer")
    assert done == ["outer"]


def test_interruption_elsewhere_is_immediate():
    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)
        pytest.fail("went on")


def test_interruption_while_the_command_is_loaded_ends_it_in_one_line(tmp_path):
    """Whoever changed their mind at once got twenty lines of a traceback."""
    (tmp_path / "click.py").write_text("import os\nos.kill(os.getpid(), 2)\n")
    found = os.pathsep.join([str(tmp_path), os.environ["PYTHONPATH"]])
    environment = os.environ | {"PYTHONPATH": found}
    done = subprocess.run(["gr-wiforce"], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (130, "gr-wiforce: interrupted\n")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_ignored_interruption_stays_ignored(number):
    """A shell lets its background commands ignore Ctrl-C, and nohup the end of the terminal."""
    signal.signal(number, signal.SIG_IGN)
    interrupt_by_exception()
    os.kill(os.getpid(), number)
    assert signal.getsignal(number) is signal.SIG_IGN
