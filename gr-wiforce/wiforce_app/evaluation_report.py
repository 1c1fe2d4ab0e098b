# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of evaluated scenes: a table, a picture per scene, and how it came about."""

from pathlib import Path

import numpy as np
from gnuradio.wiforce._config import VERSION
from gnuradio.wiforce.scene.expected import MEDIAN

_METHODS = ("ours", "paper", "paper, clock offset removed")
_HEAD = (
    "scene",
    "sensor",
    "method",
    "phase (deg)",
    "bound",
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
(plain sums at lines 1 and 4, each group against the one before), as published and with the constant
clock offset taken out that the untouched time shows. The paper's method is told when the sensor is
touched. Errors are medians over touched groups; the rms also shows the few groups in which the
force rises or falls fast, whose phase is not that of their centre. Phase errors are of the change
against the untouched sensor; the bound is the Cramer-Rao bound, as a median, for the lines that are
read. The paper's figures come from its own test set.""".splitlines()


def table(results, figures):
    """Markdown table: a row per scene, sensor and method; medians unless the head says else."""
    rows = [_HEAD, ["---"] * len(_HEAD)]
    for result in results:
        name = Path(result["scene"]).stem
        for sensor in result["sensors"]:
            for method in _METHODS:
                rows.append(_row(name, sensor, method, figures.get(name, {})))
        if result["sum"] is not None:
            claim = figures.get(name, {}).get("sum_n")
            claim = "" if claim is None else f"{claim:g} N"
            rows.append([name, "sum", "ours", *[""] * 3, _text(result["sum"]), *[""] * 4, claim])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _row(name, sensor, method, figure):
    found, ours = sensor["methods"][method], method == "ours"
    keys = ("force_n", "force_n_90", "location_mm", "location_mm_90")
    return [
        name if ours else "",
        sensor["sensor"] if ours else "",
        method,
        _text(found.get("phase_deg")),
        _text(MEDIAN * sensor["bound_rms_deg"]) if ours else "",
        _text(found.get("phase_rms_deg")),
        *(_text(found.get(key)) for key in keys),
        f"{sensor['flagged']} of {len(found.get('force_n_errors', []))}" if ours else "",
        _claim(figure) if ours else "",
    ]


def _text(value):
    return "" if value is None else f"{value:.3g}"


def _claim(figure):
    units = {"force_n": "N", "location_mm": "mm", "phase_rms_deg": "deg"}
    return ", ".join(f"{figure[key]:g} {unit}" for key, unit in units.items() if key in figure)


def write_report(results, folder, figures):
    """Writes ``report.md`` and ``NAME.png`` for every result."""
    import scipy

    names = " ".join(result["scene"] for result in results)
    lines = [
        "# Evaluation",
        "",
        f"`gr-wiforce evaluate {names}`; gr-wiforce {VERSION}, NumPy {np.__version__}, "
        f"SciPy {scipy.__version__}.",
        "",
        *_EXPLANATION,
        "",
        table(results, figures),
        "",
    ]
    for result in results:
        name = Path(result["scene"]).stem
        _plot(result, folder / f"{name}.png")
        lines += _section(name, result, figures.get(name, {}))
    (folder / "report.md").write_text("\n".join(lines), encoding="utf-8")


def _section(name, result, figure):
    lines = [f"## {name}", ""]
    if figure:
        lines += [f"The paper: {figure['text']}.", ""]
    lines += [f"Seed {result['seed']}.", ""]
    for sensor in result["sensors"]:
        expected = sensor["expected"]
        lines += [
            f"- {sensor['sensor']}: pressed is {sensor['truth_model']}, read with "
            f"{sensor['model']}. Expected by the plan: force {expected['force_n']:.3g} N, location "
            f"{expected['location_mm']:.3g} mm. {sensor['missed']} touched groups missed, "
            f"{sensor['false']} touches that were none. Flags seen: "
            f"{', '.join(sensor['flags']) or 'none'}.",
        ]
    return [*lines, "", f"![{name}]({name}.png)", ""]


def _plot(result, path):
    """Force and location over time beside the truth, and how the errors are distributed."""
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(11, 5.5), layout="constrained")
    axes = canvas.subplots(2, 2, width_ratios=(2, 1))
    canvas.suptitle(Path(result["scene"]).stem)
    for i, sensor in enumerate(result["sensors"]):
        truth = np.array(sensor["truth"], float)
        readings = np.array([row[:4] for row in sensor["readings"]], float)
        doubtful = np.array([row[4] for row in sensor["readings"]])
        for row, (column, key, label) in enumerate(
            ((2, "force_n", "force (N)"), (3, "location_mm", "location (mm)"))
        ):
            over_time, distribution = axes[row]
            known = np.where(truth[:, 1] == 1, truth[:, column], np.nan)
            over_time.plot(truth[:, 0], known, color="0.6", lw=2.5, zorder=0)
            name = sensor["sensor"]
            over_time.plot(readings[:, 0], readings[:, column], f"C{i}.", ms=4, label=name)
            over_time.plot(readings[doubtful, 0], readings[doubtful, column], "x", color="C3", ms=5)
            over_time.set_ylabel(label)
            _distributions(distribution, sensor["methods"], f"{key}_errors", f"C{i}")
            distribution.set_xlabel(f"error of {label}")
    axes[1, 0].set_xlabel("time (s); grey: truth, crosses: flagged")
    axes[0, 0].legend(fontsize=8)
    for axis in axes.flat:
        axis.grid(alpha=0.3)
    canvas.savefig(path, dpi=100)


def _distributions(axis, methods, key, color):
    for method, style in zip(_METHODS, ("-", ":", "--"), strict=True):
        errors = np.sort(methods[method].get(key, []))
        if len(errors):
            part = np.arange(1, len(errors) + 1) / len(errors)
            axis.semilogx(np.maximum(errors, 1e-4), part, style, color=color, label=method)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=7)
    axis.set_ylim(0, 1)
