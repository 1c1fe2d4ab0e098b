# SPDX-License-Identifier: GPL-3.0-or-later
"""The tables of evaluated scenes, and the page that holds them."""

import platform
from pathlib import Path
from string import Template

import numpy as np
from gnuradio.wiforce._config import VERSION

from ..shell import tables
from ..shell.tables import Column
from .experiment import CORRECTED, UNSURVEYED


def figure_text(value):
    """A number as text for a table, or none; what is text already stays."""
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.3g}"


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
    """Write ``report.md``: both tables, and how each scene was simulated and read."""
    import scipy

    names = " ".join(result["scene"] for result in results)
    causes = cause_table(results, figures)
    template = Template(Path(__file__).with_suffix(".md").read_text(encoding="utf-8"))
    page = template.substitute(
        command=f"gr-wiforce evaluate {names}",
        version=VERSION,
        python=platform.python_version(),
        numpy=np.__version__,
        scipy=scipy.__version__,
        table=table(results, figures),
        causes=f"{_CAUSES}{causes}\n\n" if causes else "",
        scenes=tables.table(_scene_rows(results), _SCENES),
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
