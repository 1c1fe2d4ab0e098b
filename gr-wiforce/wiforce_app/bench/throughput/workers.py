# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of chains, each in a process of its own, taken in turns."""

import multiprocessing
import os
import resource
import time
from dataclasses import dataclass, field

import numpy as np

# Of the largest tone, in single precision.
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Row:
    """A line of the bench.

    Attributes
    ----------
    name : str
    chain : str
        Of ``chains.CHAINS``.
    weights : ndarray, shape (M, 625)
    share : float
        Part of the recording that is read: slow chains need not read it all.
    """

    name: str
    chain: str
    weights: np.ndarray = field(repr=False)
    share: float = 1.0

    @property
    def tones(self):
        return len(self.weights)


class Worker:
    """A process that runs one chain again and again.

    Parameters
    ----------
    cpu : int or None
        The processor it is held to.
    """

    def __init__(self, row, recording, cpu):
        self.row = row
        context = multiprocessing.get_context("spawn")
        self._pipe, other = context.Pipe()
        self._process = context.Process(target=_serve, args=(other, row, recording, cpu))
        self._process.start()
        other.close()

    def run(self, clock):
        """Msps of one run by the ``wall`` or the ``cpu`` clock.

        Raises
        ------
        RuntimeError
            When the chain failed or its tones are wrong.
        """
        self._pipe.send(clock)
        try:
            answer = self._pipe.recv()
        except (EOFError, OSError):
            answer = "its process ended"
        if isinstance(answer, str):
            raise RuntimeError(f"{self.row.name}: {answer}")
        return answer

    def close(self):
        """Ends the process; returns its peak memory in MB."""
        self._pipe.send(None)
        peak = self._pipe.recv()
        self._process.join()
        return peak

    def kill(self):
        self._process.kill()
        self._process.join()


def _serve(pipe, row, recording, cpu):
    if cpu is not None:
        os.sched_setaffinity(0, {cpu})
    os.environ["GR_CONF_LOG_LOG_LEVEL"] = "warn"
    from .chains import CHAINS
    from .recording import reference_tones

    recording = recording.shortened(recording.samples * row.share)
    reference = None
    while (clock := pipe.recv()) is not None:
        try:
            if reference is None:
                reference = reference_tones(recording, row.weights)
            chain = CHAINS[row.chain](recording, row.weights)
            seconds = _timed(chain.run, clock)
            for tones in chain.tones:
                _check(tones, reference)
            pipe.send(max(1, len(chain.tones)) * recording.samples / seconds / 1e6)
        except Exception as error:
            pipe.send(f"{type(error).__name__}: {error}")
    pipe.send(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


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
