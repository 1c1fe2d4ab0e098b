# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench speed``: samples per second of the chains, compared with stock blocks."""

import multiprocessing
import os
import resource
import shutil
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field

import click
import numpy as np
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene

from ..shell.options import IntegerRange
from ..shell.progress import progress
from ..shell.tables import Column, echo, table
from .recording import reference_tones, tone_weights, write_recording

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
    bursts: bool = False  # of other transmitters, in every group

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
    from .chains import CHAINS

    row, recording, *reference = _task
    if not reference:
        reference = [reference_tones(recording, row.weights)]
        _task.extend(reference)
    chain = CHAINS[row.chain](recording, row.weights)
    seconds = _timed(chain.run, clock)
    if (tones := chain.tones) is not None:
        _check(tones, *reference)
    return recording.samples / seconds / 1e6


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


# Compared with the rows of quiet files of 16 tones.
_BURSTS = {"bursts-fc32": "file-fc32", "bursts-sc16": "file-sc16"}
# Of the quiet recording.
_BURSTS_SHARE = 0.25
# Row, number of tones, share of the recording that it reads.
_CHAINS = (
    ("stream-fc32", 16, 1.0),
    ("stream-fc32", 4, 1.0),
    ("stream-sc16", 16, 1.0),
    ("stream-sc16", 4, 1.0),
    ("block-by-block", 16, 1.0),
    ("file-fc32", 16, 1.0),
    ("file-fc32", 4, 1.0),
    ("file-sc16", 16, 1.0),
    ("file-sc16", 4, 1.0),
    ("stock-tuned", 4, 1.0),
    ("stock-default", 4, 0.5),
    ("numpy", 4, 0.4),
    ("ceiling-file-source", 0, 1.0),
    ("ceiling-read", 0, 0.4),
)
_SCENES = {"plan-still-one-tag": "demo", "plan-busy-two-tags": "two_sensors"}
COLUMNS = (
    Column("row", "name"),
    Column("tones", "tones"),
    Column("cores", "pinned", lambda pinned: "one" if pinned else "all"),
    Column("Msps", "msps", ".0f"),
    Column("95 % interval", "spread", ".0f"),
    Column("/tuned", "over_stock_tuned", ".2f"),
    Column("/default", "over_stock_default", ".1f"),
    Column("of file", "of_file_source_ceiling", ".2f"),
    Column("of read", "of_read_bandwidth", ".2f"),
    Column("MB", "peak_memory_mb", ".0f"),
)
_SC16_BYTES, _FC32_BYTES = 4, 8


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option("--runs", default=9, type=IntegerRange(3), help="Number of runs of each row.")
@click.option(
    "--megabytes", default=1000, type=IntegerRange(20), help="Size of the fc32 recording."
)
@click.option(
    "--only",
    multiple=True,
    help="Run only this row (repeatable); stock blocks and ceilings always run.",
)
@click.option(
    "--cpu-time", is_flag=True, help="Measure pinned rows in processor time, for a busy machine."
)
def speed(as_json, runs, megabytes, only, cpu_time):
    """Measure samples per second of each chain and of stock blocks.

    The tones of every run are compared with double precision. Rows run in turns, first pinned to
    one core, then free. Figures are medians with their 95 % interval; ratios are medians of the
    ratios within a turn.
    """
    from gnuradio import gr  # noqa: F401  of the chains, before the recording is made

    lines = _lines(only)
    with tempfile.TemporaryDirectory(prefix="wiforce-speed-") as place:
        samples = megabytes * 10**6 // _FC32_BYTES
        size = samples * (_FC32_BYTES + _SC16_BYTES)
        _check_room(place, round(size * (1 + _BURSTS_SHARE)), megabytes)
        recordings = [
            write_recording(place, samples),
            write_recording(place, round(samples * _BURSTS_SHARE), bursts=True),
        ]
        rows = []
        for pinned in (True, False):
            rows += _measure(lines, recordings, runs, pinned, cpu_time and pinned)
    echo({"rows": rows}, as_json, lambda _: table(rows, COLUMNS))


def _check_room(folder, size, megabytes):
    free = shutil.disk_usage(folder).free
    if size > free:
        rule = f"both recordings must fit on the disk, which has {free // 10**6} MB free"
        raise click.BadParameter(f"{rule}, got {megabytes}", param_hint="--megabytes")


def _lines(only):
    lines = [Row(name, name, tone_weights(tones), share) for name, tones, share in _CHAINS]
    lines += [Row(name, "file-sc16", _planned(scene)) for name, scene in _SCENES.items()]
    weights = tone_weights(16)
    lines += [Row(name, chain, weights, bursts=True) for name, chain in _BURSTS.items()]
    known = {line.name for line in lines}
    for name in only:
        if name not in known:
            rule = f"must be one of {', '.join(sorted(known))}"
            raise click.BadParameter(f"{rule}, got {name!r}", param_hint="--only")
    compared = ("stock-tuned", "stock-default", "ceiling-file-source", "ceiling-read")
    return [r for r in lines if not only or r.name in only or r.name in compared]


def _planned(scene):
    """Weights of the plan of a shipped scene."""
    return plan(load_scene(scene)).table.weights


def _measure(lines, recordings, runs, pinned, cpu_time):
    """Rows of the result; all lines run in turns."""
    clock = "cpu" if cpu_time else "wall"
    figures, peaks = _run_in_turns(lines, recordings, runs, pinned, clock)
    by_name = {line.name: values for line, values in zip(lines, figures, strict=True)}
    rows = []
    for line, values, peak in zip(lines, figures, peaks, strict=True):
        sc16 = "sc16" in line.chain
        read = by_name["ceiling-read"] * (_FC32_BYTES / _SC16_BYTES if sc16 else 1)
        rows.append(
            {
                "name": line.name,
                "tones": line.tones,
                "pinned": pinned,
                "msps": _median(values, 1),
                "spread": [round(float(v), 1) for v in _interval(values)],
                "over_stock_tuned": _median(values / by_name["stock-tuned"], 3),
                "over_stock_default": _median(values / by_name["stock-default"], 3),
                "of_file_source_ceiling": _median(values / by_name["ceiling-file-source"], 3),
                "of_read_bandwidth": _median(values / read, 3),
                "peak_memory_mb": round(peak, 1),
            }
        )
    return rows


def _run_in_turns(lines, recordings, runs, pinned, clock):
    """Msps of every run, (lines, runs), and peak memory of each line's process in MB."""
    cpu = max(os.sched_getaffinity(0)) if pinned else None
    workers = [Worker(line, recordings[line.bursts], cpu) for line in lines]
    try:
        for worker in workers:
            worker.run(clock)
        figures = np.empty((len(lines), runs))
        with progress("pinned" if pinned else "free", figures.size) as step:
            for turn in range(runs):
                for n, worker in enumerate(workers):
                    figures[n, turn] = worker.run(clock)
                    step(1)
        return figures, [worker.peak_memory_mb() for worker in workers]
    finally:
        for worker in workers:
            worker.close()


def _median(values, digits):
    return round(float(np.median(values)), digits)


def _interval(values):
    """95 % interval of the median from order statistics (the extremes of fewer than six runs)."""
    ordered, n = np.sort(values), len(values)
    reach = int(max(0, np.floor(n / 2 - 0.98 * np.sqrt(n))))
    return ordered[reach], ordered[n - 1 - reach]
