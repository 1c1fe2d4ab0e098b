# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of evaluated scenes: a table, a picture per scene, and how it came about."""

import platform
from pathlib import Path

import numpy as np
from gnuradio.wiforce._config import VERSION

from .checks import BETTER, CHECKS_HEAD, NEAR, checks
from .error_summary import figure_text
from .pictures import plot_distances, plot_scene

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

_EXPLANATION = """\
Each scene is simulated, then read from the same capture by this reader and by the paper's method
(plain sums at lines 1 and 4 of one antenna, each group against the one before), as published and
with the constant clock offset taken out that the untouched time shows. The paper's method is told
when the sensor is touched. Errors are medians over the groups that are touched, with touched
neighbours, ramps of the force included; the rms is over both ends and the same groups. Phase errors
are of the change against the untouched sensor, and against the group's mean reflection; force and
location count from what is pressed at the group's centre. Expected is what `gr-wiforce plan` says
of the scene; the bound is the Cramer-Rao bound for the lines that are read, with the reference's
noise. The paper's figures come from its own test set.""".splitlines()


def table(results, figures):
    """Markdown table: rows per scene, sensor and method; medians unless the head says else."""
    rows = [_HEAD, ["---"] * len(_HEAD)]
    for result in results:
        name = Path(result["scene"]).stem
        figure = figures.get(name, {})
        for sensor in result["sensors"]:
            rows += [_row(name, sensor, method, figure) for method in _METHODS]
            rows.append(_expected_row(sensor))
        if result["sum"] is not None:
            claim = "" if "sum_n" not in figure else f"{figure['sum_n']:g} N"
            rows.append(
                [name, "sum", "ours", *[""] * 2, figure_text(result["sum"]), *[""] * 4, claim]
            )
    return _markdown(rows)


def _markdown(rows):
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


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
    return [
        "",
        "",
        "expected",
        figure_text(np.mean(expected["phase_deg"])),
        f"{figure_text(sensor['bound_rms_deg'])} (bound)",
        figure_text(expected["force_n"]),
        "",
        figure_text(expected["location_mm"]),
        *[""] * 3,
    ]


def write_report(results, folder, figures):
    """Writes ``report.md``, ``NAME.png`` for every result, and ``distance.png``."""
    import scipy

    names = " ".join(result["scene"] for result in results)
    rows = [
        (*row[:4], {True: "yes", False: "NO"}.get(row[4], f"no: {row[4]}"))
        for row in checks(results, figures)
    ]
    lines = [
        "# Evaluation",
        "",
        f"`gr-wiforce evaluate {names}`; gr-wiforce {VERSION}, Python "
        f"{platform.python_version()}, NumPy {np.__version__}, SciPy {scipy.__version__}.",
        "",
        *_EXPLANATION,
        "",
        table(results, figures),
        "",
        "## What was to be reached",
        "",
        f"Of every readable scene: phase rms at least {BETTER:g} times better than the paper's "
        f"method with the clock offset removed, or within {NEAR:g} times the bound; medians as "
        "the plan expects them; the paper's own figures.",
        "",
        _markdown([CHECKS_HEAD, ["---"] * len(CHECKS_HEAD), *rows]),
        "",
    ]
    if plot_distances(results, folder, figures):
        lines += ["## Phase over distance", "", "![distance](distance.png)", ""]
    for result in results:
        name = Path(result["scene"]).stem
        plot_scene(result, folder / f"{name}.png")
        lines += _section(name, result, figures.get(name, {}))
    (folder / "report.md").write_text("\n".join(lines), encoding="utf-8")


def _section(name, result, figure):
    lines = [f"## {name}", "", result["about"], ""]
    if "text" in figure:
        lines += [f"The paper: {figure['text']}.", ""]
    lines += [f"Seed {result['seed']}.", ""]
    for sensor in result["sensors"]:
        lines += [
            f"- {sensor['sensor']}: pressed is {sensor['truth_model']}, read with "
            f"{sensor['model']}. {sensor['missed']} touched groups missed, "
            f"{sensor['false']} touches that were none. Flags seen: "
            f"{', '.join(sensor['flags']) or 'none'}.",
        ]
        if sensor["not_readable"]:
            lines.append(f"  Not readable: {sensor['not_readable']}.")
    return [*lines, "", f"![{name}]({name}.png)", ""]
