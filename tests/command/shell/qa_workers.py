# SPDX-License-Identifier: GPL-3.0-or-later
"""Tasks in other processes: results, errors and processes that end too early."""

import os
import pickle
import signal
import subprocess
import sys
from pathlib import Path

import click
import pytest
from click.testing import CliRunner
from gnuradio.wiforce.errors import InputError, OutputError
from machine import wait_until
from wiforce_app.shell.options import worker_options
from wiforce_app.shell.workers import WorkerLost, end_within, run_tasks, spawned


def square_or_fail(number):
    """A task: its square, an error for odd numbers, and one that cannot be sent for 5."""
    if number == 5:
        raise _Unpicklable(1, 2)
    if number % 2:
        raise InputError("number", "must be even", number)
    return number**2, os.getpid()


def end_process_unless_marked(folder):
    """A task that is killed, as by a system that is out of memory, but where it was attempted."""
    mark = Path(folder) / "attempted"
    if not mark.exists():
        if mark.parent.exists():
            mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return "done"


class _Unpicklable(Exception):
    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


def test_run_tasks_returns_each_result_and_error_once():
    outcomes = {outcome.index: outcome for outcome in run_tasks(square_or_fail, range(6), 2)}
    assert sorted(outcomes) == list(range(6))
    assert [outcomes[i].get()[0] for i in (0, 2, 4)] == [0, 4, 16]
    assert os.getpid() not in {outcomes[i].get()[1] for i in (0, 2, 4)}
    with pytest.raises(InputError, match="number: must be even, got 3"):
        outcomes[3].get()
    with pytest.raises(RuntimeError, match="_Unpicklable: 1 2"):
        outcomes[5].get()


def test_run_tasks_repeats_killed_task_and_gives_up_one_that_always_is(tmp_path):
    """One poisonous capture must neither stop the others nor be tried for ever."""
    tasks = [str(tmp_path), str(tmp_path / "absent")]
    once, always = run_tasks(end_process_unless_marked, tasks, 1)
    assert once.get() == "done"
    with pytest.raises(WorkerLost, match="ended 3 times"):
        always.get()


def test_output_error_survives_the_way_between_processes():
    error = pickle.loads(pickle.dumps(OutputError("a.csv", "cannot be written (disk full)")))
    assert str(error) == "a.csv: cannot be written (disk full)"


# Tasks leave a file named after their process, and take long the second time.
KILLED = """
import os, signal, sys, time
from pathlib import Path
from wiforce_app.shell.workers import run_tasks

def note_process(folder):
    mark = Path(folder) / str(os.getpid())
    if mark.exists():
        time.sleep(60)
    mark.touch()

if __name__ == "__main__":
    outcomes = run_tasks(note_process, [str(Path(__file__).parent)] * 3, 2)
    next(outcomes)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_workers_of_a_command_that_was_killed_end_silently(tmp_path):
    """They kept their memory until the machine was started again."""
    (tmp_path / "program.py").write_text(KILLED)
    with open(tmp_path / "errors", "w") as errors:
        done = subprocess.run([sys.executable, tmp_path / "program.py"], stderr=errors)
    assert done.returncode == -signal.SIGKILL
    workers = [Path("/proc") / file.name for file in tmp_path.glob("[0-9]*")]
    assert workers
    wait_until(lambda: not any(worker.exists() for worker in workers), 20)
    assert "Traceback" not in (tmp_path / "errors").read_text()


def test_scheduler_is_ignored_with_a_warning_that_says_what_to_use():
    """A script of the release before goes on, on one machine."""
    command = click.command()(worker_options(lambda jobs: click.echo(f"{jobs} jobs")))
    done = CliRunner().invoke(command, ["--scheduler", "x:1", "--jobs", "2"])
    assert "this machine's cores are used (--jobs)" in done.output and "2 jobs" in done.output


def test_process_beside_the_command_gets_none_of_its_signals(tmp_path, monkeypatch):
    """Ctrl-C while the page of a live run was starting printed its traceback."""
    (tmp_path / "beside.py").write_text("import os, sys\nos.write(int(sys.argv[1]), b'runs')")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [])
    read, write = os.pipe()
    process = spawned("beside", write)
    os.close(write)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
        process.send_signal(number)
    with open(read, "rb") as said:
        assert said.read() == b"runs"
    assert process.wait(60) == 0
    assert signal.pthread_sigmask(signal.SIG_BLOCK, []) == before


def test_process_that_hangs_is_killed_where_the_wait_for_it_is_interrupted(monkeypatch):
    """After a second Ctrl-C, a driver that hung kept its device from the next run."""
    process = subprocess.Popen([sys.executable, "-S", "-c", "import time; time.sleep(60)"])

    def interrupted(limit_s):
        monkeypatch.undo()
        raise KeyboardInterrupt

    monkeypatch.setattr(process, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        end_within(process, 30)
    assert process.poll() == -signal.SIGKILL
