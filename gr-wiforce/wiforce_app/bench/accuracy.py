# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench accuracy``: phase errors of the estimators against the Cramer-Rao bound."""

import click

from ..shell.options import IntegerRange, worker_options
from ..shell.progress import progress
from ..shell.tables import Column, echo, table
from ..shell.workers import run_tasks
from .cases import cases, run_case, summarise

_QUICK_RUNS, _FULL_RUNS = 10, 40
COLUMNS = (
    Column("case", "case"),
    Column("estimator", "estimator"),
    Column("rms (deg)", "rms_deg", ".3g"),
    Column("bound (deg)", "bound_deg", ".3g"),
    Column("loss (dB)", "loss_db", ".2f"),
    Column("in 2 std", "within_2_std", ".0%"),
    Column("n", "n"),
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option(
    "--full", is_flag=True, help="4 000 errors per row instead of 1 000, and a run of 20 minutes."
)
@click.option("--case", "part", default="", help="Run only cases whose name contains this.")
@click.option("--seed", type=IntegerRange(0), default=1, show_default=True)
@worker_options
def accuracy(as_json, full, part, seed, jobs):
    """Compare phase errors of each estimator with the Cramer-Rao bound.

    Monte Carlo simulation of channel snapshots: noise, fading, static and moving clutter, clock
    offset and drift, group length, off state, two tags, missing snapshots.
    """
    wanted = [case for case in cases(full) if part in case.name]
    if not wanted:
        raise click.BadParameter(f"no case has a name that contains {part!r}", param_hint="--case")
    rows = measure(wanted, _FULL_RUNS if full else _QUICK_RUNS, seed, jobs)
    echo({"rows": rows}, as_json, lambda _: table(rows, COLUMNS))


def measure(wanted, runs, seed=1, jobs=None):
    """Run cases so often, unless they say otherwise; a row per case and estimator."""
    # The longest first, so that all cores end at about the same time.
    tasks = [(case, run, seed) for case in wanted for run in range(case.runs or runs)]
    tasks.sort(key=lambda task: -task[0].groups)
    results = {}
    with progress("measuring", len(tasks)) as step:
        for outcome in run_tasks(_work, tasks, jobs):
            case, run, _ = tasks[outcome.index]
            results[case.name, run] = outcome.get()
            step(1)
    return [
        summarise(
            case,
            estimator,
            [results[case.name, run][estimator] for run in range(case.runs or runs)],
        )
        for case in wanted
        for estimator in case.estimators
    ]


def _work(task):
    return run_case(*task)
