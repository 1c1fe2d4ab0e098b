# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench speed``: samples per second of the chains, compared with stock blocks."""

import multiprocessing
import os
import shutil
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field

import click
import numpy as np
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene

from ..shell.log import progress
from ..shell.options import IntegerRange
from ..shell.tables import Column, echo, table
from .recording import reference_tones, tone_weights, write_recording

# Of the largest tone, in single precision.
TOLERANCE = 1e-5


@dataclass(frozen=True)
class Row:
    """A line of the bench: a chain, its weights (M, 625), and the share of samples it reads."""

    name: str
    chain: str
    weights: np.ndarray = field(repr=False)
    share: float = 1.0
    bursts: bool = False  # of other transmitters, in every group


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
# Compared with the rows of quiet files of 16 tones.
_BURSTS = {"bursts-fc32": "file-fc32", "bursts-sc16": "file-sc16"}
# Key of a ratio, and the row that it is over.
_RATIOS = {
    "over_stock_tuned": "stock-tuned",
    "over_stock_default": "stock-default",
    "of_file_source_ceiling": "ceiling-file-source",
    "of_read_bandwidth": "ceiling-read",
}
COLUMNS = (
    Column("row", "name"),
    Column("tones", "tones"),
    Column("Msps", "msps", ".0f"),
    Column("95 % interval", "spread", ".0f"),
    Column("/tuned", "over_stock_tuned", ".2f"),
    Column("/default", "over_stock_default", ".1f"),
    Column("of file", "of_file_source_ceiling", ".2f"),
    Column("of read", "of_read_bandwidth", ".2f"),
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
@click.option("--cpu-time", is_flag=True, help="Measure in processor time, for a busy machine.")
def speed(as_json, runs, megabytes, only, cpu_time):
    """Measure samples per second of each chain and of stock blocks, on one core.

    The tones of every run are compared with double precision. Rows run in turns. Figures are
    medians with their 95 % interval; ratios are medians of the ratios within a turn.
    """
    from gnuradio import gr  # noqa: F401  of the chains, before the recording is made

    lines = _lines(only)
    with tempfile.TemporaryDirectory(prefix="wiforce-speed-") as place:
        samples = megabytes * 10**6 // _FC32_BYTES
        size = 2 * samples * (_FC32_BYTES + _SC16_BYTES)
        if size > (free := shutil.disk_usage(place).free):
            rule = f"both recordings must fit on the disk, which has {free // 10**6} MB free"
            raise click.BadParameter(f"{rule}, got {megabytes}", param_hint="--megabytes")
        recordings = [
            write_recording(place, samples),
            write_recording(place, samples, bursts=True),
        ]
        rows = _rows(lines, _run_in_turns(lines, recordings, runs, "cpu" if cpu_time else "wall"))
    echo({"rows": rows}, as_json, lambda _: table(rows, COLUMNS))


def _lines(only):
    lines = [Row(name, name, tone_weights(tones), share) for name, tones, share in _CHAINS]
    lines += [
        Row(name, "file-sc16", plan(load_scene(scene)).table.weights)
        for name, scene in _SCENES.items()
    ]
    weights = tone_weights(16)
    lines += [Row(name, chain, weights, bursts=True) for name, chain in _BURSTS.items()]
    known = {line.name for line in lines}
    for name in only:
        if name not in known:
            rule = f"must be one of {', '.join(sorted(known))}"
            raise click.BadParameter(f"{rule}, got {name!r}", param_hint="--only")
    return [r for r in lines if not only or r.name in only or r.name in _RATIOS.values()]


def _run_in_turns(lines, recordings, runs, clock):
    """Msps of every run, (lines, runs): a process for each line, all pinned to one core."""
    cpu, context = max(os.sched_getaffinity(0)), multiprocessing.get_context("spawn")
    with ExitStack() as ended, progress("measuring", len(lines) * runs) as step:
        pools = [
            ended.enter_context(
                ProcessPoolExecutor(1, context, _begin, (line, recordings[line.bursts], cpu))
            )
            for line in lines
        ]
        figures = np.empty((1 + runs, len(lines)))
        for turn in figures:
            for n, pool in enumerate(pools):
                turn[n] = pool.submit(_run, clock).result()
                step(1)
    return figures[1:].T  # the first run of each fills caches


# Of a line's process: its row and recording, and the tones that are right.
_task = []


def _begin(row, recording, cpu):
    os.sched_setaffinity(0, {cpu})
    os.environ["GR_CONF_LOG_LOG_LEVEL"] = "warn"
    recording = recording.shortened(recording.samples * row.share)
    _task[:] = row, recording, reference_tones(recording, row.weights)


def _run(clock):
    """Msps of one run by the ``wall`` or the ``cpu`` clock, if its tones are right."""
    from .chains import CHAINS

    row, recording, reference = _task
    chain = CHAINS[row.chain](recording, row.weights)
    now = time.process_time if clock == "cpu" else time.perf_counter
    start = now()
    chain.run()
    seconds = now() - start
    if (tones := chain.tones) is not None:
        check_tones(row.name, tones, reference)
    return recording.samples / seconds / 1e6


def check_tones(name, tones, reference):
    """Holds every tone to the reference. A stock chain may leave its last group unfinished."""
    if len(tones) not in (len(reference), len(reference) - 1):
        raise ValueError(f"{name}: {len(tones)} groups instead of {len(reference)}")
    error = np.abs(tones - reference[: len(tones)]).max() / np.abs(reference).max()
    if not error <= TOLERANCE:
        raise ValueError(f"{name}: tones are {error:.1e} off, more than {TOLERANCE:.0e}")


def _rows(lines, figures):
    """Rows of the result from Msps of every run."""
    by_name = {line.name: values for line, values in zip(lines, figures, strict=True)}
    rows = []
    for line, values in zip(lines, figures, strict=True):
        ordered, n = np.sort(values), len(values)
        # 95 % interval of the median from order statistics (the extremes of fewer than six runs).
        reach = int(max(0, np.floor(n / 2 - 0.98 * np.sqrt(n))))
        ratios = {key: values / by_name[other] for key, other in _RATIOS.items()}
        if "sc16" in line.chain:
            ratios["of_read_bandwidth"] *= _SC16_BYTES / _FC32_BYTES
        rows.append(
            {
                "name": line.name,
                "tones": len(line.weights),
                "msps": round(float(np.median(values)), 1),
                "spread": ordered[[reach, n - 1 - reach]].round(1).tolist(),
                **{key: round(float(np.median(ratio)), 3) for key, ratio in ratios.items()},
            }
        )
    return rows
