# SPDX-License-Identifier: GPL-3.0-or-later
"""Independent tasks, run in parallel on the cores of this machine or on a Dask cluster."""

import multiprocessing
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import Any

from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.optional import optional_module

# For a process that was asked to end: what it removes are files.
_END_S = 1.0
_TERMINATED = 128 + signal.SIGTERM
# A worker that disappears may have been killed by another task's need for memory.
_ATTEMPTS = 3
_ANSWER_S = 10.0
_ADDRESS = re.compile(r"((tcp|tls)://)?(\[[\da-fA-F:]+\]|[\w.-]+):\d{1,5}")


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
    """A worker process ended, or lost its connection, before it had returned a result."""


def run_tasks(function, tasks: Sequence, jobs=None, scheduler=None) -> Iterator[Outcome]:
    """Call a function of a module with each task, in other processes; yields outcomes as they end.

    A task whose worker disappears is repeated, at most twice. On a cluster any task that fails is
    repeated on another worker, if there is one: its files may be out of reach for the first.
    """
    if scheduler is not None:
        return _on_cluster(function, tasks, scheduler)
    return _on_cores(function, tasks, jobs or len(os.sched_getaffinity(0)))


def _on_cores(function, tasks, jobs):
    attempts, waiting = [0] * len(tasks), list(range(len(tasks)))
    while waiting:
        # A fork would copy the threads of libraries in a state that they do not expect.
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(min(jobs, len(waiting)), context, _prepare_worker)
        running, lost = {}, []
        try:
            running = {pool.submit(_outcome_of, function, tasks[index]): index for index in waiting}
            for done in as_completed(running):
                index = running[done]
                error = done.exception()
                if isinstance(error, BrokenProcessPool):
                    lost.append(index)
                else:
                    yield _outcome(index, *(("error", error) if error else done.result()))
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


def _outcome(index, kind, value):
    return Outcome(index, **{kind: value})


def _prepare_worker():
    """Leave Ctrl-C, which a terminal sends to all processes, to the command itself.

    The command then ends its workers by SIGTERM, and they remove what is not complete. They do so
    themselves when the command was killed, and would otherwise wait for tasks forever.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _end_with(multiprocessing.parent_process().join)


def _outcome_of(function, task):
    """``result`` or ``error`` of a call, and its value, as they can be sent to another process."""
    try:
        return "result", function(task)
    except Exception as error:
        try:
            pickle.loads(pickle.dumps(error))
        except Exception:
            # An exception whose constructor takes something else than its text.
            return "error", RuntimeError(f"{type(error).__name__}: {error}")
        return "error", error


def _end_with(gone: Callable[[], object]) -> None:
    """End this process, as SIGTERM does, when that it works for has: ``gone`` returns then.

    In both cases it removes what it has not completed.
    """

    def watch():
        gone()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(_END_S)
        os._exit(_TERMINATED)

    # Nothing is to be removed yet, and an exception here would be printed.
    signal.signal(signal.SIGTERM, lambda *_: os._exit(_TERMINATED))
    threading.Thread(target=watch, daemon=True).start()
    signal.signal(signal.SIGTERM, _end)


def _end(*_):
    # Python prints a traceback of any other exception that ends a process.
    raise SystemExit(_TERMINATED)


def _on_cluster(function, tasks, scheduler):
    client = _connect(scheduler)
    from distributed import as_completed

    with closing(client), client.as_current():
        attempts, failed_on = [0] * len(tasks), [set() for _ in tasks]
        running = {}

        def submit(index):
            workers = set(client.scheduler_info()["workers"])
            others = sorted(workers - failed_on[index]) if failed_on[index] else None
            payload = pickle.dumps((function, tasks[index]))
            future = client.submit(_in_child, payload, pure=False, workers=others or None)
            running[future.key] = index
            attempts[index] += 1
            return future

        # Futures must be kept: a cluster forgets tasks that nobody waits for.
        futures = [submit(index) for index in range(len(tasks))]
        stream = as_completed(futures)
        for done in stream:
            index = running.pop(done.key)
            if done.status == "finished":
                kind, value, worker = done.result()
                outcome = _outcome(index, kind, value)
            else:
                error, worker = done.exception(), None
                outcome = Outcome(index, error=WorkerLost(str(error) or type(error).__name__))
            # A cluster computes results that are still wanted again when their worker is lost.
            done.release()
            if outcome.error is None or attempts[index] == _ATTEMPTS:
                yield outcome
                continue
            failed_on[index].add(worker)
            if not set(client.scheduler_info()["workers"]) - failed_on[index]:
                yield outcome
                continue
            stream.add(submit(index))


def _connect(scheduler):
    distributed = optional_module("distributed", "--scheduler")
    if not _ADDRESS.fullmatch(scheduler):
        raise InputError("--scheduler", "must be an address as tcp://HOST:8786", scheduler)

    class Client(distributed.Client):
        def __del__(self):
            # One that was never connected would wait, and print a traceback.
            if self.status == "running":
                super().__del__()

    try:
        client = Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
    except (OSError, ValueError, TypeError) as error:
        rule = f"no Dask scheduler answers within {_ANSWER_S:g} s"
        raise InputError("--scheduler", rule, scheduler) from error
    if not client.scheduler_info()["workers"]:
        client.close()
        raise InputError("--scheduler", "the cluster has no workers", scheduler)
    return client


def _in_child(payload):
    """Run a task in a process of its own; on a worker of a cluster.

    The worker has imported NumPy with settings of its own, and may run several tasks in threads,
    of which Python executes one at a time.
    """
    from distributed import get_worker

    status, answer, errors = run_in_child(payload)
    address = get_worker().address
    if status:
        last = errors.decode(errors="replace").strip().rpartition("\n")[2]
        text = last or f"its process ended with status {status}"
        return "error", WorkerLost(f"{text} (worker {address})"), address
    return (*pickle.loads(answer), address)


def run_in_child(payload: bytes) -> tuple[int, bytes, bytes]:
    """Run a pickled function and argument in a process of its own, which ends with this one.

    Returns its exit status, the pickled outcome, where that is 0, and what it has printed.
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
        with suppress(BrokenPipeError):  # it has ended, with a status
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
        _end_with(lambda: os.read(0, 1))
        answer.write(pickle.dumps(_outcome_of(*task)))


if __name__ == "__main__":
    main()
