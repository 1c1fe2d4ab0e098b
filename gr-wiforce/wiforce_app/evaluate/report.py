# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of evaluated scenes: error tables, requirements, a picture per scene."""

import platform
from pathlib import Path
from string import Template

import numpy as np
from gnuradio.wiforce._config import VERSION

from ..shell.tables import table_of_cells
from .error_summary import figure_text
from .pictures import plot_distances, plot_scene

CHECKS_HEAD = ("scene", "sensor", "requirement", "measured", "met")
# Factors within which the plan must predict phase, force and location; limits of the phase rms.
_FACTORS = {"phase_deg": 1.5, "force_n": 2.0, "location_mm": 2.0}
BETTER, NEAR = 3.0, 1.5
# Largest deviation from a published figure without error bars that a cause may leave.
WITHIN = 0.1
# Why errors may exceed what the plan of a shipped scene expects: its scene does not describe this.
UNDESCRIBED = {
    "phantom_synthesizers": "the plan counts phase noise as if all paths had one delay",
    "tabletop_two": "the plan does not know that edges inside long symbols count as noise",
    "uncalibrated_radio": "the plan does not know the compression and images of the radio",
    "warm_day": "the plan does not know the drift",
}
_JITTER = "the plan does not know the jitter of the clock"
# Published quantities, with their units.
_UNITS = {"force_n": "N", "location_mm": "mm", "phase_rms_deg": "deg"}


def checks(results, figures):
    """Check the requirements of every scene; rows as in ``CHECKS_HEAD``."""
    rows = []
    for result in results:
        name = Path(result["scene"]).stem
        figure = figures.get(name, {})
        for sensor in result["sensors"]:
            ours = sensor["methods"]["ours"]
            if sensor["expected"]["phase_deg"] is None:
                measured = f"{sensor['unflagged']} unflagged readings"
                found = [("no unflagged readings", measured, sensor["unflagged"] == 0)]
            else:
                reason = UNDESCRIBED.get(name, _JITTER if result["causes"] else False)
                planned = [(*check, met or reason) for *check, met in _plan_checks(sensor)]
                found = [_phase_check(sensor, figure), *planned]
            found += _figure_checks(ours, figure)
            rows += [(name, sensor["sensor"], *check) for check in found]
        sensor = result["sensors"][0]["sensor"]
        rows += [(name, sensor, *check) for check in _cause_checks(result["causes"], figure)]
        if "sum_n" in figure and result["sum"] is not None:
            measured = f"{figure_text(result['sum'])} N"
            rows.append(
                (name, "sum", "the paper's figure", measured, result["sum"] <= figure["sum_n"])
            )
    return rows


def _phase_check(sensor, figure):
    rms = sensor["methods"]["ours"].get("phase_rms_deg", np.inf)
    paper = sensor["methods"]["paper, clock offset removed"].get("phase_rms_deg", 0.0)
    better, near = paper / rms, rms / sensor["bound_rms_deg"]
    held = better >= BETTER or near <= NEAR
    measured = f"{better:.3g} times lower than the paper's, {near:.3g} times the bound"
    return "phase rms", measured, held or figure.get("reason", False)


def _plan_checks(sensor):
    expected, ours = sensor["expected"], sensor["methods"]["ours"]
    for key, factor in _FACTORS.items():
        wanted = np.mean(expected[key]) if expected[key] is not None else np.nan
        ratio = ours.get(key, np.nan) / wanted
        what = f"plan's {key.partition('_')[0]} within {factor:g}"
        yield what, f"{ratio:.2f} times expected", bool(1 / factor <= ratio <= factor)


def fitted_figure(figure):
    """The published quantity that causes explain: its key, value and unit."""
    key = "phase_rms_deg" if "phase_rms_deg" in figure else "force_n"
    return key, figure[key], _UNITS[key]


def _cause_checks(causes, figure):
    for cause, found in causes.items():
        key, wanted, unit = fitted_figure(figure)
        error = figure.get("error_bar", WITHIN * wanted)
        value = found["paper"][key]
        span = f"{wanted - error:.3g} to {wanted + error:.3g} {unit}"
        what = f"{cause}: the paper's method gives {span}"
        yield what, f"{figure_text(value)} {unit}", bool(abs(value - wanted) <= error)


def _figure_checks(ours, figure):
    for key, unit in _UNITS.items():
        if key in figure:
            value = ours.get(key, np.inf)
            yield (
                f"the paper's {figure[key]:.3g} {unit}",
                f"{figure_text(value)} {unit}",
                value <= figure[key],
            )
    if "within_10mm" in figure:
        share = np.mean(np.array(ours.get("location_mm_errors", [np.inf])) <= 10)
        what = f"the paper's {100 * figure['within_10mm']:g} % within 10 mm"
        yield what, f"{100 * share:.0f} %", bool(share >= figure["within_10mm"])


_METHODS = ("ours", "paper", "paper, clock offset removed")
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
        f"{sensor['flagged']} of {len(found.get('force_n_errors', []))}" if ours else "",
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
    held = [
        (*row[:4], {True: "yes", False: "NO"}.get(row[4], f"no: {row[4]}"))
        for row in checks(results, figures)
    ]
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
        better=f"{BETTER:g}",
        near=f"{NEAR:g}",
        within=f"{100 * WITHIN:g}",
        checks=table_of_cells(CHECKS_HEAD, held),
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
