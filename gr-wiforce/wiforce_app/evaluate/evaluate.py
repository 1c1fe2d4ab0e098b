# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce evaluate``: errors against the truth, of many scenes, and the paper's figures."""

import json
import platform
from pathlib import Path
from string import Template

import click
import numpy as np
from gnuradio.wiforce._config import VERSION
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.text.textfile import check_output, write_csv, write_whole
from gnuradio.wiforce.scene import load_scene, sampled_scenes, simulation_warnings

from ..shell.log import log, progress
from ..shell.options import scene_names, worker_options
from ..shell.provenance import fingerprint
from ..shell.tables import Column, table
from ..shell.workers import run_tasks
from . import published
from .experiment import CORRECTED, other_causes, run

# Of the stored results; those of another one are computed again.
_FORMAT = 7


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
    names = list(dict.fromkeys(sampled_scenes() if "all" in scenes else scenes))
    folder = Path(folder)
    files = [folder / f"{Path(name).stem}.json" for name in names]
    for name, file in zip(names, files, strict=True):
        if files.count(file) > 1:
            raise InputError("scenes", "must have different file names", name)
    # Invalid scenes are refused before any work is done.
    loaded = [load_scene(name) for name in names]
    hashes = []
    for name, scene in zip(names, loaded, strict=True):
        if scene.packets is not None:
            raise InputError(name, "is a scene of packets; only scenes of samples are evaluated")
        for warning in simulation_warnings(scene):
            log.warning(f"{name}: {warning}")
        hashes.append(fingerprint(scene, other_causes(str(name)), _FORMAT, simulated=True))
    folder.mkdir(parents=True, exist_ok=True)
    for output in (folder / "report.md", *files):
        check_output(output, [file for scene in loaded for file in scene.files])
    results = [None if fresh else stored(*known) for known in zip(files, hashes, strict=True)]
    missing = [i for i, result in enumerate(results) if result is None]
    with progress("evaluating", len(missing)) as step:
        for outcome in run_tasks(_run, [(names[i], str(folder)) for i in missing], jobs):
            i = missing[outcome.index]
            results[i] = outcome.get()
            write_whole(files[i], json.dumps({"fingerprint": hashes[i], "result": results[i]}))
            step(1)
    figures = published.paper_figures()
    tables = error_table(results, figures)
    if causes := cause_table(results, figures):
        tables += f"\n\n{causes}"
    _write_report(results, folder, tables)
    click.echo(f"{tables}\n\nreport: {folder / 'report.md'}")


@evaluate.command()
@click.option(
    "-o", "--output", type=click.Path(), help="Write every reading with its errors (CSV)."
)
def paper(output):
    """Score the models on the paper's wireless trials."""
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
    click.echo(f"limits of these data, and the paper's other series: {published.FOLDER}")


_TRIALS = (
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
    click.echo("errors: median, 90th percentile")
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
    click.echo(f"{table(rows, _TRIALS)}\n")


def _errors(scores):
    """Cells of a method's readings."""
    force, location = published.errors(scores)
    known = scores.method.iloc[0] == "location known"
    return {
        "force": _distribution(force),
        "location": "known" if known else _distribution(location),
        "n": len(scores),
        "within": np.mean(force <= 2 * scores.force_std_n),
    }


def _distribution(errors):
    return f"{errors.median():.2f}, {errors.quantile(0.9):.2f}"


def _run(task):
    return run(*task)


def stored(file, current):
    """The result that a file holds; None when there is none with this hash."""
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content["result"] if content.get("fingerprint") == current else None


def _figure_text(value):
    """A number as text for a table, or none; what is text already stays."""
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.3g}"


_METHODS = ("ours", "paper", CORRECTED)
_ERRORS = (
    Column("force (N)", "force_n", _figure_text),
    Column("90 %", "force_n_90", _figure_text),
    Column("location (mm)", "location_mm", _figure_text),
    Column("90 %", "location_mm_90", _figure_text),
    Column("flagged", "flagged"),
)
_COLUMNS = (
    Column("scene", "scene"),
    Column("sensor", "sensor"),
    Column("method", "method"),
    Column("phase (deg)", "phase_deg", _figure_text),
    Column("phase rms", "phase_rms_deg", _figure_text),
    *_ERRORS,
    Column("paper's figure", "published"),
)
_CAUSES = (
    Column("scene", "scene"),
    Column("published", "published"),
    Column("cause", "cause"),
    Column("paper's method", "papers"),
    Column("phase rms of ours", "phase_rms_deg", _figure_text),
    *_ERRORS[::2],
)


def error_table(results, figures):
    """Markdown: rows per scene, sensor and method; medians unless titled rms or 90 %."""
    rows = []
    for result in results:
        name = Path(result["scene"]).stem
        figure = figures.get(name, {})
        for sensor in result["sensors"]:
            ours, *others = ({"method": m, **sensor["methods"][m]} for m in _METHODS)
            ours |= {
                "scene": name,
                "sensor": sensor["sensor"],
                "flagged": f"{sensor['flagged']} of {ours.get('read', 0)}",
                "published": figure.get("text"),
            }
            if result["causes"]:
                ours["phase_rms_deg"] = _ranges(result["causes"])["phase_rms_deg"]
            rows += [ours, *others, _expected(sensor)]
        if result["sum"] is not None:
            claim = f"{figure['sum_n']:g} N" if "sum_n" in figure else ""
            summed = {"method": "ours", "force_n": result["sum"], "published": claim}
            rows.append({"scene": name, "sensor": "sum", **summed})
    return table(rows, _COLUMNS)


def _expected(sensor):
    expected = sensor["expected"]
    if expected["phase_deg"] is None:
        return {"method": "expected: not readable"}
    least = "at most" if sensor["radio_noise"] else "bound"
    return {
        **expected,
        "method": "expected over the span",
        "phase_deg": np.mean(expected["phase_deg"]),
        "phase_rms_deg": f"{_figure_text(sensor['bound_rms_deg'])} ({least})",
    }


def cause_table(results, figures):
    """Markdown: a row per cause that explains a published figure, and one with our range."""
    rows = []
    for result in results:
        if not (causes := result["causes"]):
            continue
        name = Path(result["scene"]).stem
        figure = figures[name]
        key, unit = ("phase_rms_deg", "deg") if "phase_rms_deg" in figure else ("force_n", "N")
        # Error bars, where the paper has some.
        bar = figure.get("error_bar")
        ends = [figure[key]] if bar is None else [figure[key] - bar, figure[key] + bar]
        first = {"scene": name, "published": f"{' to '.join(map(_figure_text, ends))} {unit}"}
        for cause, found in causes.items():
            papers = f"{_figure_text(found['paper'][key])} {unit}"
            flagged = f"{found['flagged']} of {found['read']}"
            own = {"cause": cause, "papers": papers, "flagged": flagged}
            rows.append({**first, **own, **found["ours"]})
            first = {}
        rows.append({"cause": "range of ours", **_ranges(causes)})
    return table(rows, _CAUSES) if rows else ""


def _ranges(causes):
    """Least and largest of our errors over the causes, as texts."""
    ranges = {}
    for key in ("phase_rms_deg", "force_n", "location_mm"):
        ours = [found["ours"][key] for found in causes.values()]
        values = [value for value in ours if value is not None]
        ranges[key] = f"{min(values):.3g} to {max(values):.3g}" if values else ""
    return ranges


def _write_report(results, folder, tables):
    """Write ``report.md``: the tables, and how they came about."""
    import scipy

    template = Template(Path(__file__).with_name("report.md").read_text(encoding="utf-8"))
    page = template.substitute(
        command=f"gr-wiforce evaluate {' '.join(result['scene'] for result in results)}",
        version=VERSION,
        python=platform.python_version(),
        numpy=np.__version__,
        scipy=scipy.__version__,
        tables=tables,
    )
    (folder / "report.md").write_text(page, encoding="utf-8")
