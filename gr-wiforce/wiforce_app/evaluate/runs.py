# SPDX-License-Identifier: GPL-3.0-or-later
"""Many scenes as experiments: run in parallel, stored, resumed, and their report."""

import json
import platform
from pathlib import Path
from string import Template

import click
import numpy as np
from gnuradio.wiforce._config import VERSION
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.text.textfile import check_output, write_whole
from gnuradio.wiforce.scene import load_scene, sampled_scenes, simulation_warnings

from ..shell.log import log, progress
from ..shell.provenance import fingerprint
from ..shell.tables import Column
from ..shell.tables import table as markdown_table
from ..shell.workers import run_tasks
from .experiment import CORRECTED, UNSURVEYED, other_causes, run
from .published import paper_figures

# Of the stored results; those of another one are computed again.
_FORMAT = 6


def evaluate_scenes(names, folder, jobs=None, fresh=False):
    """Run scenes (or ``all``) without a stored result, or ``fresh`` ones, and report."""
    names = list(dict.fromkeys(sampled_scenes() if "all" in names else names))
    files = [folder / f"{Path(name).stem}.json" for name in names]
    for name, file in zip(names, files, strict=True):
        if files.count(file) > 1:
            raise InputError("scenes", "must have different file names", name)
    # Invalid scenes are refused before any work is done.
    scenes = [load_scene(name) for name in names]
    hashes = []
    for name, scene in zip(names, scenes, strict=True):
        if scene.packets is not None:
            raise InputError(name, "is a scene of packets; only scenes of samples are evaluated")
        for warning in simulation_warnings(scene):
            log.warning(f"{name}: {warning}")
        hashes.append(fingerprint(scene, other_causes(str(name)), _FORMAT, simulated=True))
    folder.mkdir(parents=True, exist_ok=True)
    for output in (folder / "report.md", *files):
        check_output(output, [file for scene in scenes for file in scene.files])
    results = [None if fresh else stored(*known) for known in zip(files, hashes, strict=True)]
    missing = [i for i, result in enumerate(results) if result is None]
    with progress("evaluating", len(missing)) as step:
        for outcome in run_tasks(_run, [(names[i], str(folder)) for i in missing], jobs):
            i = missing[outcome.index]
            results[i] = outcome.get()
            write_whole(files[i], json.dumps({"fingerprint": hashes[i], "result": results[i]}))
            step(1)
    figures = paper_figures()
    _write_report(results, folder, figures)
    click.echo(table(results, figures))
    if causes := cause_table(results, figures):
        click.echo(f"\n{causes}")
    click.echo(f"\nreport: {folder / 'report.md'}")


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


_METHODS = ("ours", UNSURVEYED, "paper", CORRECTED)
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
_CAUSES_HEAD = """## Published figures and what may cause them

The paper does not state why its phases varied. Each row adds one disturbance to the scene, as
strong as makes the paper's method, with the clock offset removed, measure what was published. What
this receiver reads depends on the cause, so only the range over the causes can stand next to the
paper's figure.

"""


def table(results, figures):
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
    return markdown_table(rows, _COLUMNS)


def _expected(sensor):
    expected = sensor["expected"]
    if expected["phase_deg"] is None:
        return {"method": "expected: not readable"}
    least = "at most" if sensor["radio_noise"] else "bound"
    return {
        **expected,
        "method": "expected",
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
    return markdown_table(rows, _CAUSES) if rows else ""


def _ranges(causes):
    """Least and largest of our errors over the causes, as texts."""
    ranges = {}
    for key in ("phase_rms_deg", "force_n", "location_mm"):
        ours = [found["ours"][key] for found in causes.values()]
        values = [value for value in ours if value is not None]
        ranges[key] = f"{min(values):.3g} to {max(values):.3g}" if values else ""
    return ranges


def _write_report(results, folder, figures):
    """Write ``report.md``: both tables, and how each scene was simulated and read."""
    import scipy

    names = " ".join(result["scene"] for result in results)
    causes = cause_table(results, figures)
    template = Template(Path(__file__).with_name("report.md").read_text(encoding="utf-8"))
    page = template.substitute(
        command=f"gr-wiforce evaluate {names}",
        version=VERSION,
        python=platform.python_version(),
        numpy=np.__version__,
        scipy=scipy.__version__,
        table=table(results, figures),
        causes=f"{_CAUSES_HEAD}{causes}\n\n" if causes else "",
        scenes=markdown_table(_scene_rows(results), _SCENES),
    )
    (folder / "report.md").write_text(page, encoding="utf-8")


_SCENES = (
    Column("scene", "scene"),
    Column("seed", "seed"),
    Column("sensor", "sensor"),
    Column("simulated with", "truth_model"),
    Column("read with", "model"),
    Column("missed touches", "missed"),
    Column("false touches", "false"),
    Column("flags", "flags"),
    Column("not readable", "not_readable"),
    Column("about", "about"),
)


def _scene_rows(results):
    for result in results:
        first = {key: result[key] for key in ("scene", "seed", "about")}
        for sensor in result["sensors"]:
            yield {**first, **sensor, "flags": " ".join(sensor["flags"])}
            first = {}
