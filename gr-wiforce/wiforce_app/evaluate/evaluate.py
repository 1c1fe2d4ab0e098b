# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce evaluate``: errors against the truth and against the figures of the paper."""

from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.io.text.textfile import check_output, write_csv

from ..shell.options import scene_names, worker_options
from ..shell.progress import progress
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
def scenes(scenes, folder, jobs, scheduler, fresh):
    """Simulate, read and score SCENES (or all), and write a report."""
    from .runs import evaluate_scenes

    evaluate_scenes(scenes, Path(folder), jobs, fresh, scheduler)


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
    with progress("evaluating", published.models_scored()) as step:
        scores = published.score_presses(vna, presses, step)
    if output is not None:
        _write_scores(output, scores)
    for frequency in published.FREQUENCIES_HZ:
        own = [score for score in scores if score.press.frequency_hz == frequency]
        _print_frequency(frequency, own)
    for line in series_lines():
        click.echo(line)
    click.echo("Limits of these data")
    for limit in published.LIMITS:
        click.echo(f"- {limit}")


def _print_frequency(frequency, scores):
    force, location = published.CLAIMS[frequency]
    presses = len({id(score.press) for score in scores})
    click.echo(f"{frequency / 1e6:g} MHz, {presses} published wireless presses of trials 1 to 3")
    click.echo(f"paper, own test set: median {force:.2f} N, {location:.2f} mm")
    click.echo(f"curves chosen by cross-validation on the VNA data: {scores[0].form}")
    click.echo()
    errors = f"{'median':>7}{'95 %':>12}{'90th':>8}"
    click.echo(f"{'pooled':40}{'force error (N)':^28}{'location error (mm)':^28}")
    click.echo(f"{'model, method':40}{errors} {errors}{'n':>6}{'in 2 sigma':>11}")
    for refined in (False, True):
        click.echo(_title(refined))
        for method in published.METHODS:
            own = _select(scores, refined, method)
            click.echo(f"  {method:38}" + _row(own))
            if method == "single reading":
                label = f"{method}, not {published.UNOBSERVABLE_MM:g} mm"
                away = [s for s in own if s.press.location_mm != published.UNOBSERVABLE_MM]
                click.echo(f"  {label:38}" + _row(away))
    click.echo()


def _title(refined):
    return "VNA and one wireless press per location" if refined else "VNA alone"


def _select(scores, refined, method):
    return [score for score in scores if (score.refined, score.method) == (refined, method)]


def _row(scores):
    """Median, interval and 90th percentile of both errors, count and coverage."""
    force = [score.force_error for score in scores]
    text = _errors(force)
    if scores[0].method == "location known":
        text += f" {'known':>8}{'':>12}{'':>7}"
    else:
        text += " " + _errors([score.location_error for score in scores], width=7)
    pooled = np.concatenate(force)
    within = pooled <= 2 * np.concatenate([score.force_std_n for score in scores])
    return text + f"{pooled.size:>6}{100 * np.mean(within):>10.0f} %"


def _errors(errors, width=8):
    pooled = np.concatenate(errors)
    interval = ""
    if len(errors) > 1:
        interval = "{:.2f}-{:.2f}".format(*published.bootstrap_median(errors))
    return f"{np.median(pooled):>{width}.2f}{interval:>12}{np.quantile(pooled, 0.9):>{width}.2f}"


def _write_scores(path, scores):
    """Every reading of the scored presses beside what was applied."""
    import pandas

    frames = [
        pandas.DataFrame(
            {
                "freq_mhz": f"{score.press.frequency_hz / 1e6:g}",
                "form": score.form,
                "wireless_calibration": int(score.refined),
                "method": score.method,
                "location_mm": f"{score.press.location_mm:g}",
                "trial": score.press.trial,
                "force_n": score.press.force_n,
                "estimated_force_n": score.force_n,
                "force_std_n": score.force_std_n,
                "estimated_location_mm": score.location_mm,
                "location_std_mm": score.location_std_mm,
                "flags": [" ".join(flags) for flags in score.flags],
            }
        )
        for score in scores
    ]
    write_csv(path, pandas.concat(frames))
