# SPDX-License-Identifier: GPL-3.0-or-later
"""Processes beside the command: of a radio, of the page, and of independent tasks in parallel."""

import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

# For a process that was asked to end: what it removes are files.
_END_S = 1.0
_TERMINATED = 128 + signal.SIGTERM
# Of a terminal or a group of processes, meant for the command, which ends its processes.
_OF_THE_COMMAND = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1)
# A worker that disappears may have been killed by another task's need for memory.
_ATTEMPTS = 3


def spawned(module: str, *descriptors: int) -> subprocess.Popen[bytes]:
    """A process that runs a module of this package, whose arguments are open descriptors.

    Signals for the command never reach it, even while it starts.
    """
    packages = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
    environment = {"PYTHONPATH": os.pathsep.join(filter(None, packages)), "PYTHONSAFEPATH": "1"}
    kept = signal.pthread_sigmask(signal.SIG_BLOCK, _OF_THE_COMMAND)  # which it inherits
    try:
        return subprocess.Popen(
            [sys.executable, "-m", module, *map(str, descriptors)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,  # GNU Radio logs there
            env=os.environ | environment,
            pass_fds=descriptors,
        )
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, kept)


def end_within(process: subprocess.Popen[bytes], limit_s: float) -> None:
    """Wait for a process to end, and kill it after a time, or when the wait is interrupted."""
    try:
        with suppress(subprocess.TimeoutExpired):
            process.wait(limit_s)
    finally:
        process.kill()  # which does nothing to one that has ended
        process.wait()


@dataclass(frozen=True)
class Outcome:
    """What became of a task: what the function returned, or why there is no result."""

    index: int
    result: Any = None
    error: Exception | None = None

    def get(self) -> Any:
        """The result; raises the error of a task that failed."""
        if self.error is not None:
            raise self.error
        return self.result


class WorkerLost(Exception):
    """A worker process ended before it had returned a result."""


def run_tasks(function, tasks: Sequence, jobs=None) -> Iterator[Outcome]:
    """Call a function with each task in other processes, thrice at most; outcomes as they end."""
    jobs = jobs or len(os.sched_getaffinity(0))
    attempts, waiting = [0] * len(tasks), list(range(len(tasks)))
    while waiting:
        # A fork would copy the threads of libraries in a state that they do not expect.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(min(jobs, len(waiting)), context, _prepare_worker)
        running, lost = {}, []
        try:
            running = {pool.submit(_outcome_of, function, i, tasks[i]): i for i in waiting}
            for done in as_completed(running):
                error = done.exception()
                if isinstance(error, BrokenProcessPool):
                    lost.append(running[done])
                else:
                    yield Outcome(running[done], error=error) if error else done.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            _end_children()
            raise
        pool.shutdown()
        # It is not known whose process ended: the first tasks in the queue were under way.
        waiting = []
        for place, index in enumerate(sorted(lost)):
            attempts[index] += place < jobs
            if attempts[index] < _ATTEMPTS:
                waiting.append(index)
            else:
                text = f"its process ended {_ATTEMPTS} times; is there enough memory?"
                yield Outcome(index, error=WorkerLost(text))


def _end_children():
    """End all workers before their files are removed; one that has a task waiting takes it up."""
    children = multiprocessing.active_children()
    for process in children:
        process.terminate()
    deadline = time.monotonic() + _END_S
    for process in children:
        process.join(max(0.0, deadline - time.monotonic()))
        if process.is_alive():
            process.kill()
            process.join()


def _outcome_of(function, index, task):
    """The outcome of a call, as it can be sent to another process."""
    try:
        return Outcome(index, function(task))
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            # An exception whose constructor takes something else than its text.
            return Outcome(index, error=RuntimeError(f"{type(error).__name__}: {error}"))
        return Outcome(index, error=error)


def _prepare_worker():
    """Leave Ctrl-C to the command, which ends its workers; end as by SIGTERM when it was killed."""

    def watch():
        multiprocessing.parent_process().join()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_END_S)
        os._exit(_TERMINATED)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Nothing is to be removed yet, and an exception here would be printed.
    signal.signal(signal.SIGTERM, lambda *_: os._exit(_TERMINATED))
    threading.Thread(target=watch, daemon=True).start()
    signal.signal(signal.SIGTERM, _end)


def _end(*_):
    # Python prints a traceback of any other exception that ends a process.
    raise SystemExit(_TERMINATED)
