# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench accuracy``: phase errors of the estimators against the Cramer-Rao bound."""

import dataclasses
import json

import click

from ..shell.options import IntegerRange, worker_options
from ..shell.progress import progress
from ..shell.workers import run_tasks
from .cases import cases
from .rooms import RoomRow, joined, room_cases, room_table

_QUICK_RUNS, _FULL_RUNS = 10, 40


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
    if plot_path is not None:
        from ..shell.plots import check_picture

        check_picture(plot_path)
    rows = measure(wanted, _FULL_RUNS if full else _QUICK_RUNS, seed, jobs, scheduler)
    if as_json:
        click.echo(json.dumps({"rows": [dataclasses.asdict(row) for row in rows]}, indent=1))
    else:
        of_rooms = [row for row in rows if isinstance(row, RoomRow)]
        others = [row for row in rows if not isinstance(row, RoomRow)]
        parts = [table(others)] if others else []
        parts += [room_table(of_rooms)] if of_rooms else []
        click.echo("\n\n".join(parts))
    if plot_path is not None:
        from .picture import plot_losses

        plot_losses(rows, wanted, plot_path)


def measure(wanted, runs, seed=1, jobs=None, scheduler=None):
    """Run cases on all cores, or on a cluster.

    Parameters
    ----------
    wanted : sequence of Case or RoomCase
    runs : int
        Per case, unless the case says otherwise.
    seed : int
    jobs : int, optional
        Processes; one per core by default.
    scheduler : str, optional
        Address of a Dask scheduler.

    Returns
    -------
    list of montecarlo.Row or rooms.RoomRow
        Case by case, estimator by estimator.
    """
    # The longest first, so that all cores end at about the same time.
    tasks = [(case, run, seed) for case in wanted for run in range(case.runs or runs)]
    tasks.sort(key=lambda task: -task[0].groups)
    found = {case.name: [] for case in wanted}
    with progress("measuring", len(tasks)) as step:
        for outcome in run_tasks(_work, tasks, jobs, scheduler):
            name, run, result = outcome.get()
            found[name].append((run, result))
            step(1)
    rows = []
    for case in wanted:
        results = [result for _, result in sorted(found[case.name], key=lambda item: item[0])]
        for estimator in case.estimators:
            rows.append(case.summarise(estimator, [result[estimator] for result in results]))
    return rows


def _work(task):
    case, run, seed = task
    return case.name, run, case.run(run, seed)


def table(rows):
    """Rows as text, one line each; values of the ends are separated by slashes."""
    head = f"{'case':<52}{'estimator':<23}{'rms (deg)':>33}{'bound (deg)':>33}{'loss (dB)':>26}"
    lines = [head + f"{'+- (dB)':>9}{'in 2 std':>12}{'s/s':>8}{'n':>7}"]
    for row in rows:
        if not row.n:
            lines.append(f"{row.case:<52}{row.estimator:<23}{'no reading':>33}")
            continue
        half = max((high - low) / 2 for low, high in row.loss_interval_db)
        inside = "/".join(f"{100 * part:.0f}" for part in row.within_2_std)
        lines.append(
            f"{row.case:<52}{row.estimator:<23}{joined(row.rms_deg):>33}"
            f"{joined(row.bound_deg):>33}{joined(row.loss_db, '.2f'):>26}{half:9.2f}"
            f"{inside:>12}{row.seconds_per_second:8.4f}{row.n:7d}"
        )
    return "\n".join(lines)
