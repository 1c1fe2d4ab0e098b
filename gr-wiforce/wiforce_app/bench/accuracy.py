# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench accuracy``: phase errors of the estimators against the Cramer-Rao bound."""

import tempfile
import time
import zlib
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.expected import expect
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.planning.room.report import changes_of, skipped_of
from gnuradio.wiforce.receiver.recording import RecordingReader
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.simulation.truth import read_truth, score

from ..evaluate.error_summary import calibration_bias_deg
from ..evaluate.experiment import with_mean_phases
from ..shell.options import IntegerRange, worker_options
from ..shell.plots import check_picture
from ..shell.progress import progress
from ..shell.tables import Column, echo, table
from ..shell.workers import run_tasks
from .cases import cases

# Scenes that state nothing under ``environment``, and one without any disturbance.
ROOMS = (
    "demo",
    "office_wifi",
    "workshop_lamps",
    "cheap_tag",
    "uncalibrated_radio",
    "warm_day",
    "somebody_walks",
)
_ROOM_RUNS, _FULL_ROOM_RUNS = 4, 12
# A reading is wrong if it is unflagged and its error exceeds all of these: std, N, mm.
_WRONG = (5.0, 0.3, 1.0)


@dataclass(frozen=True)
class RoomCase:
    """A shipped scene, which gives a row with and one without the survey of its room."""

    scene: str
    runs: int

    @property
    def name(self):
        return f"room: {self.scene}"

    estimators = ("surveyed", "not surveyed")
    groups = 1_000  # in the order of the tasks: a run takes as long as that of so many groups

    def run(self, run, seed):
        """Simulate with another seed and read twice; estimator to a dict."""
        scene = load_scene(self.scene)
        number = zlib.crc32(repr((seed, Path(self.scene).name, run)).encode())
        scene = replace(scene, simulation=replace(scene.simulation, seed=number))
        with tempfile.TemporaryDirectory() as folder:
            simulate(scene, Path(folder) / "capture")
            truth = with_mean_phases(scene, read_truth(f"{folder}/capture.truth.csv"))
            capture = open_capture(Path(folder) / "capture")
            return {
                name: _read(scene, capture, name == "surveyed", truth) for name in self.estimators
            }

    def summarise(self, estimator, results):
        """Combine the results of all runs to a row."""
        return summarise(self, estimator, results)


def room_cases(full=False):
    """A case per room, in the order of the report."""
    return [RoomCase(scene, _FULL_ROOM_RUNS if full else _ROOM_RUNS) for scene in ROOMS]


def _read(scene, recording, survey, truth):
    """One run: errors of the groups whose neighbours are touched as well.

    Columns of ``errors`` and ``std`` are force (N) and location (mm).
    """
    settings, began, began_own = plan(scene), time.process_time(), time.thread_time()
    reader = RecordingReader(recording, settings, frame_offset=0, survey=survey)
    start_s = time.thread_time() - began_own  # another thread folds the first groups meanwhile
    readings = [reading for batch in reader for reading in batch]
    cpu_s = time.process_time() - began - start_s
    found = score(readings, truth, scene.sensors[0].name)
    stds = [[reading.force_std_n, reading.location_std_mm] for reading in found.compared]
    return {
        "phase_deg": wrap_deg(found.phase_error_deg - calibration_bias_deg(scene, 0)),
        "errors": np.column_stack([found.force_error_n, found.location_error_mm]),
        "std": np.reshape(stds, (-1, 2)),
        "flagged": np.array([bool(reading.flags) for reading in found.compared], bool),
        "unread": found.missed,
        "bound_deg": np.array(expect(settings)[0].phase_std_deg),
        "added": changes_of(settings, reader.plan),
        "skipped": skipped_of(reader.plan),
        "start_s": start_s,
        "cpu_s": cpu_s,
        "signal_s": scene.simulation.duration_s,
    }


def summarise(case, estimator, runs):
    """Combine the runs of a room to a row.

    Phases have an entry per end; the bound is that of the scene without its disturbances. Shares
    ``within_2_std`` are of unflagged forces and locations, ``unflagged`` is of the touched groups.
    ``wrong`` counts unflagged readings off by more than five of their standard deviations and by
    more than 0.3 N or 1 mm. ``added`` and ``skipped`` are what the surveys decided.
    """
    phases, errors, std, flagged = (
        np.concatenate([run[name] for run in runs])
        for name in ("phase_deg", "errors", "std", "flagged")
    )
    rms = np.sqrt(np.mean(phases**2, axis=0))
    bound = np.sqrt(np.mean([run["bound_deg"] ** 2 for run in runs], axis=0))
    clear = np.abs(errors[~flagged])
    clear_std, limits = std[~flagged], np.array(_WRONG[1:])
    unread = sum(run["unread"] for run in runs)
    wrong = np.any((clear > _WRONG[0] * clear_std) & (clear > limits), axis=1)
    return {
        "case": case.name,
        "estimator": estimator,
        "rms_deg": rms.tolist(),
        "bound_deg": bound.tolist(),
        "loss_db": (20 * np.log10(rms / bound)).tolist(),
        "force_median_n": float(np.median(np.abs(errors[:, 0]))),
        "within_2_std": np.mean(clear <= 2 * clear_std, axis=0).tolist(),
        "unflagged": len(clear) / (len(errors) + unread),
        "wrong": int(np.sum(wrong)),
        "added": _counted([_without_numbers(run["added"]) for run in runs]),
        "skipped": _counted([run["skipped"] for run in runs]),
        "start_s": float(np.mean([run["start_s"] for run in runs])),
        "seconds_per_second": sum(run["cpu_s"] for run in runs) / sum(r["signal_s"] for r in runs),
        "n": len(errors),
        "unread": unread,
    }


def _counted(texts_of_runs):
    """Texts of all runs, those of some with their number."""
    counts = Counter(text for texts in texts_of_runs for text in texts)
    runs = len(texts_of_runs)
    return [
        text if count == runs else f"{text} ({count} of {runs} runs)"
        for text, count in counts.items()
    ]


def _without_numbers(texts):
    """What was added, without the frequencies that differ from run to run."""
    return [
        text.partition(" of ")[0] if text.startswith("adds the tag") else text for text in texts
    ]


ROOM_COLUMNS = (
    Column("room", "case"),
    Column("reader", "estimator"),
    Column("rms (deg)", "rms_deg", ".3g"),
    Column("bound (deg)", "bound_deg", ".3g"),
    Column("loss (dB)", "loss_db", ".1f"),
    Column("force (N)", "force_median_n", ".3f"),
    Column("in 2 std", "within_2_std", ".0%"),
    Column("unflagged", "unflagged", ".0%"),
    Column("wrong", "wrong"),
    Column("s/s", "seconds_per_second", ".4f"),
    Column("n", "n"),
)


def room_table(rows):
    """Rows of rooms as a table, and below it what the survey decided."""
    decided = []
    for row in rows:
        if row["estimator"] == "surveyed":
            added, skipped = (", ".join(row[key]) or "nothing" for key in ("added", "skipped"))
            decided += [f"{row['case']}: added: {added}", f"{'':<6}skipped: {skipped}"]
    return "\n".join([table(rows, ROOM_COLUMNS), "", *decided])


_QUICK_RUNS, _FULL_RUNS = 10, 40
COLUMNS = (
    Column("case", "case"),
    Column("estimator", "estimator"),
    Column("rms (deg)", "rms_deg", ".3g"),
    Column("bound (deg)", "bound_deg", ".3g"),
    Column("loss (dB)", "loss_db", ".2f"),
    Column("interval (dB)", "loss_interval_db", lambda pair: f"{pair[0]:.2f} to {pair[1]:.2f}"),
    Column("in 2 std", "within_2_std", ".0%"),
    Column("s/s", "seconds_per_second", ".4f"),
    Column("n", "n"),
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option(
    "--full", is_flag=True, help="4 000 errors per row instead of 1 000, and a run of 20 minutes."
)
@click.option("--case", "part", default="", help="Run only cases whose name contains this.")
@click.option(
    "--plot",
    "plot_path",
    type=click.Path(),
    help="Write a picture of loss over SNR (PNG, PDF or SVG).",
)
@click.option("--seed", type=IntegerRange(0), default=1, show_default=True)
@worker_options
def accuracy(as_json, full, part, plot_path, seed, jobs, scheduler):
    """Compare phase errors of each estimator with the Cramer-Rao bound.

    Monte Carlo simulation of channel snapshots: noise, fading, static and moving clutter, clock
    offset and drift, group length, off state, two tags, missing snapshots. Shipped scenes of rooms
    are simulated at sample level and read with and without the survey.
    """
    wanted = [case for case in [*cases(full), *room_cases(full)] if part in case.name]
    if not wanted:
        raise click.BadParameter(f"no case has a name that contains {part!r}", param_hint="--case")
    check_picture(plot_path)
    rows = measure(wanted, _FULL_RUNS if full else _QUICK_RUNS, seed, jobs, scheduler)
    rooms = {case.name for case in wanted if isinstance(case, RoomCase)}
    own, of_rooms = ([r for r in rows if (r["case"] in rooms) is i] for i in (False, True))
    parts = [lambda _: table(own, COLUMNS)] if own else []
    parts += [lambda _: room_table(of_rooms)] if of_rooms else []
    echo({"rows": rows}, as_json, *parts)
    if plot_path is not None:
        from .picture import plot_losses

        plot_losses(rows, wanted, plot_path)


def measure(wanted, runs, seed=1, jobs=None, scheduler=None):
    """Run cases so often, unless they say otherwise; a row per case and estimator, in this order.

    Runs are spread over the cores, or over the cluster of a Dask scheduler.
    """
    # The longest first, so that all cores end at about the same time.
    tasks = [(case, run, seed) for case in wanted for run in range(case.runs or runs)]
    tasks.sort(key=lambda task: -task[0].groups)
    results = {}
    with progress("measuring", len(tasks)) as step:
        for outcome in run_tasks(_work, tasks, jobs, scheduler):
            case, run, _ = tasks[outcome.index]
            results[case.name, run] = outcome.get()
            step(1)
    return [
        case.summarise(
            estimator,
            [results[case.name, run][estimator] for run in range(case.runs or runs)],
        )
        for case in wanted
        for estimator in case.estimators
    ]


def _work(task):
    case, run, seed = task
    return case.run(run, seed)
