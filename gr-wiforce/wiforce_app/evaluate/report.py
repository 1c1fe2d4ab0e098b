# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of evaluated scenes: error tables, a picture per scene."""

import platform
from pathlib import Path
from string import Template

import numpy as np
from gnuradio.wiforce._config import VERSION

from ..shell.tables import table_of_cells
from .error_summary import figure_text
from .experiment import CORRECTED, UNSURVEYED
from .pictures import plot_distances, plot_scene


def fitted_figure(figure):
    """The published quantity that causes explain: its key, value and unit."""
    key, unit = ("phase_rms_deg", "deg") if "phase_rms_deg" in figure else ("force_n", "N")
    return key, figure[key], unit


_METHODS = ("ours", UNSURVEYED, "paper", CORRECTED)
_HEAD = (
    "scene",
    "sensor",
    "method",
    "phase (deg)",
    "phase rms",
    "force (N)",
    "90 %",
    "location (mm)",
    "90 %",
    "flagged",
    "paper's figure",
)


_PHASE_RMS = _HEAD.index("phase rms")


def table(results, figures):
    """Markdown: rows per scene, sensor and method; medians unless titled rms or 90 %.

    Our phase rms is a range where several causes explain the figure that the paper published.
    """
    rows = []
    for result in results:
        name = Path(result["scene"]).stem
        figure = figures.get(name, {})
        for sensor in result["sensors"]:
            rows += [_row(name, sensor, method, figure) for method in _METHODS]
            if result["causes"]:
                rows[-len(_METHODS)][_PHASE_RMS] = _range(result["causes"], "phase_rms_deg")
            rows.append(_expected_row(sensor))
        if result["sum"] is not None:
            claim = "" if "sum_n" not in figure else f"{figure['sum_n']:g} N"
            rows.append(
                [name, "sum", "ours", *[""] * 2, figure_text(result["sum"]), *[""] * 4, claim]
            )
    return table_of_cells(_HEAD, rows)


_CAUSE_HEAD = (
    "scene",
    "published",
    "cause",
    "paper's method",
    "phase rms of ours",
    "force (N)",
    "location (mm)",
    "flagged",
)
# Our errors in the last columns but one.
_OURS = ("phase_rms_deg", "force_n", "location_mm")


def cause_table(results, figures):
    """Markdown: a row per cause that explains a published figure, and one with our range."""
    rows = []
    for result in results:
        name, causes = Path(result["scene"]).stem, result["causes"]
        if not causes:
            continue
        key, wanted, unit = fitted_figure(figures[name])
        published = f"{figure_text(wanted)} {unit}"
        if "error_bar" in figures[name]:
            bar = figures[name]["error_bar"]
            published = f"{figure_text(wanted - bar)} to {figure_text(wanted + bar)} {unit}"
        for number, (cause, found) in enumerate(causes.items()):
            ours = [figure_text(found["ours"][k]) for k in _OURS]
            first = ["", ""] if number else [name, published]
            theirs = f"{figure_text(found['paper'][key])} {unit}"
            rows.append([*first, cause, theirs, *ours, f"{found['flagged']} of {found['read']}"])
        rows.append(["", "", "range of ours", "", *(_range(causes, k) for k in _OURS), ""])
    return table_of_cells(_CAUSE_HEAD, rows) if rows else ""


def _range(causes, key):
    """Least and largest of our errors over the causes."""
    values = [found["ours"][key] for found in causes.values() if found["ours"][key] is not None]
    return f"{figure_text(min(values))} to {figure_text(max(values))}" if values else ""


def _row(name, sensor, method, figure):
    found, ours = sensor["methods"][method], method == "ours"
    keys = ("phase_deg", "phase_rms_deg", "force_n", "force_n_90", "location_mm", "location_mm_90")
    return [
        name if ours else "",
        sensor["sensor"] if ours else "",
        method,
        *(figure_text(found.get(key)) for key in keys),
        f"{sensor['flagged']} of {found.get('read', 0)}" if ours else "",
        figure.get("text", "") if ours else "",
    ]


def _expected_row(sensor):
    expected = sensor["expected"]
    if expected["phase_deg"] is None:
        return ["", "", "expected: not readable", *[""] * 8]
    least = "at most" if sensor["radio_noise"] else "bound"
    return [
        "",
        "",
        "expected",
        figure_text(np.mean(expected["phase_deg"])),
        f"{figure_text(sensor['bound_rms_deg'])} ({least})",
        figure_text(expected["force_n"]),
        "",
        figure_text(expected["location_mm"]),
        *[""] * 3,
    ]


def write_report(results, folder, figures):
    """Writes ``report.md``, ``NAME.png`` for every result, and ``distance.png``."""
    import scipy

    names = " ".join(result["scene"] for result in results)
    sections = []
    for result in results:
        name = Path(result["scene"]).stem
        plot_scene(result, folder / f"{name}.png")
        sections.append(_section(name, result, figures.get(name, {})))
    template = Template(Path(__file__).with_suffix(".md").read_text(encoding="utf-8"))
    page = template.substitute(
        command=f"gr-wiforce evaluate {names}",
        version=VERSION,
        python=platform.python_version(),
        numpy=np.__version__,
        scipy=scipy.__version__,
        table=table(results, figures),
        causes=_CAUSES + causes + "\n\n" if (causes := cause_table(results, figures)) else "",
        distance=_DISTANCE if plot_distances(results, folder, figures) else "",
        sections="\n".join(sections),
    )
    (folder / "report.md").write_text(page, encoding="utf-8")


_CAUSES = """## Published figures and what may cause them

The paper does not state why its phases varied. Each row adds one disturbance to the scene, as
strong as makes the paper's method, with the clock offset removed, measure what was published. What
this receiver reads depends on the cause, so only the range over the causes can stand next to the
paper's figure.

"""
_DISTANCE = "## Phase over distance\n\n![distance](distance.png)\n\n"


def _section(name, result, figure):
    lines = [f"## {name}", "", result["about"], ""]
    if "text" in figure:
        lines += [f"The paper: {figure['text']}.", ""]
    lines += [f"Seed {result['seed']}.", ""]
    for sensor in result["sensors"]:
        lines += [
            f"- {sensor['sensor']}: simulated with {sensor['truth_model']}, read with "
            f"{sensor['model']}. Missed touches: {sensor['missed']} groups; false touches: "
            f"{sensor['false']} groups. Flags: {', '.join(sensor['flags']) or 'none'}.",
        ]
        if sensor["not_readable"]:
            lines.append(f"  Not readable: {sensor['not_readable']}.")
    return "\n".join([*lines, "", f"![{name}]({name}.png)", ""])
