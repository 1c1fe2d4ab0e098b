# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of chains, each in a process of its own, taken in turns."""

import multiprocessing
import os
import resource
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from .recording import reference_tones

# Of the largest tone, in single precision.
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Row:
    """A line of the bench: a chain of ``chains.CHAINS`` with its weights (M, 625).

    ``share`` is the part of the recording that is read: slow chains need not read it all.
    """

    name: str
    chain: str
    weights: np.ndarray = field(repr=False)
    share: float = 1.0

    @property
    def tones(self):
        return len(self.weights)


class Worker:
    """A process that runs one chain again and again, held to a processor if one is given."""

    def __init__(self, row, recording, cpu):
        self.row = row
        context = multiprocessing.get_context("spawn")
        self._pool = ProcessPoolExecutor(1, context, _begin, (row, recording, cpu))

    def run(self, clock):
        """Msps of one run by the ``wall`` or the ``cpu`` clock.

        A RuntimeError names the row when the chain failed or its tones are wrong.
        """
        try:
            return self._pool.submit(_run, clock).result()
        except Exception as error:
            name = self.row.name
            raise RuntimeError(f"{name}: {type(error).__name__}: {error}") from error

    def peak_memory_mb(self):
        """Of the process."""
        return self._pool.submit(_peak_memory_mb).result()

    def close(self):
        """Ends the process."""
        self._pool.shutdown()


# Of a worker's process: its row and recording, and the tones that are right.
_task = []


def _begin(row, recording, cpu):
    if cpu is not None:
        os.sched_setaffinity(0, {cpu})
    os.environ["GR_CONF_LOG_LOG_LEVEL"] = "warn"
    recording = recording.shortened(recording.samples * row.share)
    _task[:] = row, recording


def _run(clock):
    from .chains import CHAINS  # GNU Radio, after its logging was set

    row, recording, *reference = _task
    if not reference:
        reference = [reference_tones(recording, row.weights)]
        _task.extend(reference)
    chain = CHAINS[row.chain](recording, row.weights)
    seconds = _timed(chain.run, clock)
    for tones in chain.tones:
        _check(tones, *reference)
    return max(1, len(chain.tones)) * recording.samples / seconds / 1e6


def _peak_memory_mb():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def _timed(run, clock):
    now = time.process_time if clock == "cpu" else time.perf_counter
    start = now()
    run()
    return now() - start


def _check(tones, reference):
    """Holds every tone to the reference. A stock chain may leave its last group unfinished."""
    if len(tones) not in (len(reference), len(reference) - 1):
        raise ValueError(f"{len(tones)} groups instead of {len(reference)}")
    error = np.abs(tones - reference[: len(tones)]).max() / np.abs(reference).max()
    if not error <= TOLERANCE:
        raise ValueError(f"tones are {error:.1e} off, more than {TOLERANCE:.0e}")
