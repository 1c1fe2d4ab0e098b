# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of evaluated scenes: error tables, a picture per scene, and the versions used."""

import platform
from pathlib import Path

import numpy as np
from gnuradio.wiforce._config import VERSION

from ..markdown import filled_page, markdown_table
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


def table(results, figures):
    """Markdown: rows per scene, sensor and method; medians unless titled rms or 90 %."""
    rows = []
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
    return markdown_table(_HEAD, rows)


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
    held = [
        (*row[:4], {True: "yes", False: "NO"}.get(row[4], f"no: {row[4]}"))
        for row in checks(results, figures)
    ]
    sections = []
    for result in results:
        name = Path(result["scene"]).stem
        plot_scene(result, folder / f"{name}.png")
        sections.append(_section(name, result, figures.get(name, {})))
    page = filled_page(
        Path(__file__).with_suffix(".md"),
        command=f"gr-wiforce evaluate {names}",
        version=VERSION,
        python=platform.python_version(),
        numpy=np.__version__,
        scipy=scipy.__version__,
        table=table(results, figures),
        better=f"{BETTER:g}",
        near=f"{NEAR:g}",
        checks=markdown_table(CHECKS_HEAD, held),
        distance=_DISTANCE if plot_distances(results, folder, figures) else "",
        sections="\n".join(sections),
    )
    (folder / "report.md").write_text(page, encoding="utf-8")


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
