# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench speed``: samples per second of the chains, compared with stock blocks."""

import os
import shutil
import tempfile
import time

import click
import numpy as np
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene

from ..shell.log import progress
from ..shell.options import IntegerRange
from ..shell.tables import Column, echo, table
from .chains import CHAINS, reference_tones, tone_weights, write_recording

# Of the largest tone, in single precision.
TOLERANCE = 1e-5

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
    "of_file_source_ceiling": "ceiling-file-source",
    "of_read_bandwidth": "ceiling-read",
}
COLUMNS = (
    Column("row", "name"),
    Column("tones", "tones"),
    Column("Msps", "msps", ".0f"),
    Column("95 % interval", "spread", ".0f"),
    Column("of stock", "over_stock_tuned", ".2f"),
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
def speed(as_json, runs, megabytes):
    """Measure samples per second of each chain and of stock blocks, on one core.

    The tones of every run are compared with double precision. Rows run in turns. Figures are
    medians with their 95 % interval; ratios are medians of the ratios within a turn.
    """
    from gnuradio import gr

    gr.logging().set_default_level(gr.log_levels.warn)
    os.sched_setaffinity(0, {max(os.sched_getaffinity(0))})
    with tempfile.TemporaryDirectory(prefix="wiforce-speed-") as place:
        samples = megabytes * 10**6 // _FC32_BYTES
        size = 2 * samples * (_FC32_BYTES + _SC16_BYTES)
        if size > (free := shutil.disk_usage(place).free):
            rule = f"both recordings must fit on the disk, which has {free // 10**6} MB free"
            raise click.BadParameter(f"{rule}, got {megabytes}", param_hint="--megabytes")
        quiet, bursts = (write_recording(place, samples, hit) for hit in (False, True))
        lines = [
            (name, name, tone_weights(tones), quiet.shortened(quiet.samples * share))
            for name, tones, share in _CHAINS
        ]
        lines += [
            (name, "file-sc16", plan(load_scene(scene)).table.weights, quiet)
            for name, scene in _SCENES.items()
        ]
        lines += [(name, chain, tone_weights(16), bursts) for name, chain in _BURSTS.items()]
        figures = np.empty((1 + runs, len(lines)))
        with progress("measuring", figures.size) as step:
            for turn in figures:
                for n, line in enumerate(lines):
                    turn[n] = _msps(*line)
                    step(1)
    rows = _rows(lines, figures[1:].T)  # the first run of each fills caches
    echo({"rows": rows}, as_json, lambda _: table(rows, COLUMNS))


def _msps(name, chain, weights, recording):
    """Msps of one run of a chain, if its tones are right."""
    made = CHAINS[chain](recording, weights)
    start = time.perf_counter()
    made.run()
    seconds = time.perf_counter() - start
    if (tones := made.tones) is not None:
        check_tones(name, tones, reference_tones(recording, weights))
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
    by_name = {name: values for (name, *_), values in zip(lines, figures, strict=True)}
    rows = []
    for (name, chain, weights, _), values in zip(lines, figures, strict=True):
        ordered, n = np.sort(values), len(values)
        # 95 % interval of the median from order statistics (the extremes of fewer than six runs).
        reach = int(max(0, np.floor(n / 2 - 0.98 * np.sqrt(n))))
        ratios = {key: values / by_name[other] for key, other in _RATIOS.items()}
        if "sc16" in chain:
            ratios["of_read_bandwidth"] *= _SC16_BYTES / _FC32_BYTES
        rows.append(
            {
                "name": name,
                "tones": len(weights),
                "msps": round(float(np.median(values)), 1),
                "spread": ordered[[reach, n - 1 - reach]].round(1).tolist(),
                **{key: round(float(np.median(ratio)), 3) for key, ratio in ratios.items()},
            }
        )
    return rows
