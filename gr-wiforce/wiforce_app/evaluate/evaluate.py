# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce evaluate``: errors against the truth and against the figures of the paper."""

from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.io.text.textfile import check_output, write_csv

from ..shell.options import scene_names, worker_options
from ..shell.tables import Column, table
from . import published
from .published import series_lines


class _PaperOrScenes(click.Group):
    """Takes ``paper``, or names of scenes."""

    def resolve_command(self, ctx, args):
        if args and args[0] in self.commands:
            return super().resolve_command(ctx, args)
        return "scenes", self.commands["scenes"], args


@click.group(cls=_PaperOrScenes, subcommand_metavar="paper | all | SCENE... [OPTIONS]")
def evaluate():
    """Compare readings with the truth and with the figures of the paper.

    paper: score the models on the published wireless trials. SCENE...: simulate, read and score
    these scenes. all: every shipped scene. See also: gr-wiforce evaluate all --help.
    """


@evaluate.command(hidden=True)
@click.argument("scenes", nargs=-1, required=True, shell_complete=scene_names)
@click.option(
    "--folder",
    type=click.Path(file_okay=False),
    default="evaluation",
    show_default=True,
    help="Where results and report are kept; existing results are not computed again.",
)
@worker_options
@click.option("--fresh", is_flag=True, help="Compute all results again.")
def scenes(scenes, folder, jobs, fresh):
    """Simulate, read and score SCENES (or all), and write a report."""
    from .runs import evaluate_scenes

    evaluate_scenes(scenes, Path(folder), jobs, fresh)


@evaluate.command()
@click.option(
    "-o", "--output", type=click.Path(), help="Write every reading with its errors (CSV)."
)
def paper(output):
    """Score the models on the paper's wireless trials, and print its other series."""
    if output is not None:
        check_output(output)
    vna = published.FOLDER / "vna.csv"
    presses = published.published_presses()
    scores = published.score_presses(vna, presses)
    if output is not None:
        shown = {key: scores[key].map("{:g}".format) for key in ("freq_mhz", "location_mm")}
        write_csv(output, scores.assign(**shown))
    for frequency, own in scores.groupby("freq_mhz"):
        _print_frequency(1e6 * frequency, own)
    for line in series_lines():
        click.echo(line)
    click.echo("Limits of these data")
    for limit in published.LIMITS:
        click.echo(f"- {limit}")


_COLUMNS = (
    Column("calibrated by VNA and", "calibrated"),
    Column("method", "method"),
    Column("force error (N)", "force"),
    Column("location error (mm)", "location"),
    Column("n", "n"),
    Column("in 2 std", "within", ".0%"),
)


def _print_frequency(frequency, scores):
    force, location = published.CLAIMS[frequency]
    presses = len(scores.groupby(["trial", "location_mm"]))
    click.echo(f"{frequency / 1e6:g} MHz, {presses} published wireless presses of trials 1 to 3")
    click.echo(f"paper, own test set: median {force:.2f} N, {location:.2f} mm")
    click.echo(f"curves chosen by cross-validation on the VNA data: {scores.form.iloc[0]}")
    click.echo("errors: median (95 % interval), 90th percentile")
    click.echo()
    away = f"not {published.UNOBSERVABLE_MM:g} mm"
    rows = []
    for refined in (0, 1):
        for method in published.METHODS:
            own = scores[(scores.wireless_calibration == refined) & (scores.method == method)]
            calibrated = "one wireless press per location" if refined else "nothing else"
            rows.append({"calibrated": calibrated, "method": method, **_errors(own)})
            if method == "single reading":
                other = own[own.location_mm != published.UNOBSERVABLE_MM]
                rows.append({**rows[-1], "method": f"{method}, {away}", **_errors(other)})
    click.echo(f"{table(rows, _COLUMNS)}\n")


def _errors(scores):
    """Cells of a method's readings."""
    force, location = published.errors(scores)
    known = scores.method.iloc[0] == "location known"
    presses = [scores.trial, scores.location_mm]
    return {
        "force": _distribution(force, presses),
        "location": "known" if known else _distribution(location, presses),
        "n": len(scores),
        "within": np.mean(force <= 2 * scores.force_std_n),
    }


def _distribution(errors, presses):
    low, high = published.bootstrap_median([own for _, own in errors.groupby(presses)])
    return f"{errors.median():.2f} ({low:.2f}-{high:.2f}), {errors.quantile(0.9):.2f}"
