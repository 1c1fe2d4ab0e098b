# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of evaluated scenes: error tables, a picture per scene."""

import platform
from pathlib import Path
from string import Template

import numpy as np
from gnuradio.wiforce._config import VERSION
from gnuradio.wiforce.io.readings import as_reading
from gnuradio.wiforce.scene import load_scene

from ..shell import tables
from ..shell.plots import plot_readings
from ..shell.tables import Column
from .error_summary import figure_text
from .experiment import CORRECTED, UNSURVEYED

_METHODS = ("ours", UNSURVEYED, "paper", CORRECTED)
_ERRORS = (
    Column("force (N)", "force_n", figure_text),
    Column("90 %", "force_n_90", figure_text),
    Column("location (mm)", "location_mm", figure_text),
    Column("90 %", "location_mm_90", figure_text),
    Column("flagged", "flagged"),
)
COLUMNS = (
    Column("scene", "scene"),
    Column("sensor", "sensor"),
    Column("method", "method"),
    Column("phase (deg)", "phase_deg", figure_text),
    Column("phase rms", "phase_rms_deg", figure_text),
    *_ERRORS,
    Column("paper's figure", "published"),
)
CAUSES = (
    Column("scene", "scene"),
    Column("published", "published"),
    Column("cause", "cause"),
    Column("paper's method", "papers"),
    Column("phase rms of ours", "phase_rms_deg", figure_text),
    *_ERRORS[::2],
)
_CAUSES = """## Published figures and what may cause them

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
    return tables.table(rows, COLUMNS)


def _expected(sensor):
    expected = sensor["expected"]
    if expected["phase_deg"] is None:
        return {"method": "expected: not readable"}
    least = "at most" if sensor["radio_noise"] else "bound"
    return {
        **expected,
        "method": "expected",
        "phase_deg": np.mean(expected["phase_deg"]),
        "phase_rms_deg": f"{figure_text(sensor['bound_rms_deg'])} ({least})",
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
        first = {"scene": name, "published": f"{' to '.join(map(figure_text, ends))} {unit}"}
        for cause, found in causes.items():
            papers = f"{figure_text(found['paper'][key])} {unit}"
            flagged = f"{found['flagged']} of {found['read']}"
            own = {"cause": cause, "papers": papers, "flagged": flagged}
            rows.append({**first, **own, **found["ours"]})
            first = {}
        rows.append({"cause": "range of ours", **_ranges(causes)})
    return tables.table(rows, CAUSES) if rows else ""


def _ranges(causes):
    """Least and largest of our errors over the causes, as texts."""
    ranges = {}
    for key in ("phase_rms_deg", "force_n", "location_mm"):
        ours = [found["ours"][key] for found in causes.values()]
        values = [value for value in ours if value is not None]
        ranges[key] = f"{min(values):.3g} to {max(values):.3g}" if values else ""
    return ranges


def write_report(results, folder, figures):
    """Writes ``report.md``, and ``NAME.png`` for every result."""
    import scipy

    names = " ".join(result["scene"] for result in results)
    for result in results:
        _plot(result, folder)
    template = Template(Path(__file__).with_suffix(".md").read_text(encoding="utf-8"))
    page = template.substitute(
        command=f"gr-wiforce evaluate {names}",
        version=VERSION,
        python=platform.python_version(),
        numpy=np.__version__,
        scipy=scipy.__version__,
        table=table(results, figures),
        causes=_CAUSES + causes + "\n\n" if (causes := cause_table(results, figures)) else "",
        sections="\n".join(_section(result, figures) for result in results),
    )
    (folder / "report.md").write_text(page, encoding="utf-8")


def _plot(result, folder):
    """Draws the readings of all sensors over time, with the truth."""
    readings = [as_reading(row) for sensor in result["sensors"] for row in sensor["readings"]]
    truth = [row for sensor in result["sensors"] for row in sensor["truth"]]
    scene, name = load_scene(result["scene"]), Path(result["scene"]).stem
    length_mm = max(sensor.load_model(scene).length_mm for sensor in scene.sensors)
    plot_readings(readings, folder / f"{name}.png", name, truth, length_mm)


def _section(result, figures):
    name = Path(result["scene"]).stem
    lines = [f"## {name}", "", result["about"], ""]
    if "text" in (figure := figures.get(name, {})):
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
