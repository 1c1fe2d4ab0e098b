# SPDX-License-Identifier: GPL-3.0-or-later
"""The report of evaluated scenes: a table, a picture per scene, and how it came about."""

import platform
from pathlib import Path

import numpy as np
from gnuradio.wiforce._config import DATA_DIR, VERSION

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
_CHECKS_HEAD = ("scene", "sensor", "check", "measured", "held")
# Factors within which the plan is to expect phase, force and location, and the phase rms's own.
_FACTORS = {"phase_deg": 1.5, "force_n": 2.0, "location_mm": 2.0}
_BETTER, _NEAR = 3.0, 1.5

_EXPLANATION = """\
Each scene is simulated, then read from the same capture by this reader and by the paper's method
(plain sums at lines 1 and 4, each group against the one before), as published and with the constant
clock offset taken out that the untouched time shows. The paper's method is told when the sensor is
touched. Errors are medians over the groups that are touched, with touched neighbours, ramps of the
force included; the rms is over both ends and the same groups. Phase errors are of the change
against the untouched sensor, and against the group's mean reflection; force and location count from
what is pressed at the group's centre. Expected is what `gr-wiforce plan` says of the scene; the
bound is the Cramer-Rao bound for the lines that are read, with the reference's noise. The paper's
figures come from its own test set.""".splitlines()


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
            rows.append([name, "sum", "ours", *[""] * 2, _text(result["sum"]), *[""] * 4, claim])
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
        *(_text(found.get(key)) for key in keys),
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
        _text(np.mean(expected["phase_deg"])),
        f"{_text(sensor['bound_rms_deg'])} (bound)",
        _text(expected["force_n"]),
        "",
        _text(expected["location_mm"]),
        *[""] * 3,
    ]


def _text(value):
    return "" if value is None else f"{value:.3g}"


def checks(results, figures):
    """What is promised of every scene, and whether it was held: rows as in ``_CHECKS_HEAD``."""
    rows = []
    for result in results:
        name = Path(result["scene"]).stem
        figure = figures.get(name, {})
        for sensor in result["sensors"]:
            ours = sensor["methods"]["ours"]
            if sensor["expected"]["phase_deg"] is None:
                measured = f"{sensor['unflagged']} unflagged readings"
                found = [("nothing is read", measured, sensor["unflagged"] == 0)]
            else:
                found = [_phase_check(sensor, figure), *_plan_checks(sensor)]
            found += _figure_checks(ours, figure)
            rows += [(name, sensor["sensor"], *check) for check in found]
        if "sum_n" in figure and result["sum"] is not None:
            measured = f"{_text(result['sum'])} N"
            rows.append(
                (name, "sum", "the paper's figure", measured, result["sum"] <= figure["sum_n"])
            )
    return rows


def _phase_check(sensor, figure):
    rms = sensor["methods"]["ours"].get("phase_rms_deg", np.inf)
    paper = sensor["methods"]["paper, clock offset removed"].get("phase_rms_deg", 0.0)
    better, near = paper / rms, rms / sensor["bound_rms_deg"]
    held = better >= _BETTER or near <= _NEAR
    measured = f"{better:.3g} x better than the paper's, {near:.3g} x the bound"
    return "phase rms", measured, held or figure.get("reason", False)


def _plan_checks(sensor):
    expected, ours = sensor["expected"], sensor["methods"]["ours"]
    for key, factor in _FACTORS.items():
        wanted = np.mean(expected[key]) if expected[key] is not None else np.nan
        ratio = ours.get(key, np.nan) / wanted
        what = f"plan's {key.partition('_')[0]} within {factor:g}"
        yield what, f"{ratio:.2f} x expected", bool(1 / factor <= ratio <= factor)


def _figure_checks(ours, figure):
    units = {"force_n": "N", "location_mm": "mm", "phase_rms_deg": "deg"}
    for key, unit in units.items():
        if key in figure:
            value = ours.get(key, np.inf)
            yield (
                f"the paper's {figure[key]:g} {unit}",
                f"{_text(value)} {unit}",
                value <= figure[key],
            )
    if "within_10mm" in figure:
        share = np.mean(np.array(ours.get("location_mm_errors", [np.inf])) <= 10)
        what = f"the paper's {100 * figure['within_10mm']:g} % within 10 mm"
        yield what, f"{100 * share:.0f} %", bool(share >= figure["within_10mm"])


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
        f"Of every readable scene: phase rms at least {_BETTER:g} times better than the paper's "
        f"method with the clock offset removed, or within {_NEAR:g} times the bound; medians as "
        "the plan expects them; the paper's own figures.",
        "",
        _markdown([_CHECKS_HEAD, ["---"] * len(_CHECKS_HEAD), *rows]),
        "",
    ]
    if plot_distances(results, folder, figures):
        lines += ["## Phase over distance", "", "![distance](distance.png)", ""]
    for result in results:
        name = Path(result["scene"]).stem
        _plot(result, folder / f"{name}.png")
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


def plot_distances(results, folder, figures):
    """``distance.png``: phase scatter over distance beside the published curve; False for none."""
    from matplotlib.figure import Figure

    at = [figures.get(Path(result["scene"]).stem, {}).get("distance_m") for result in results]
    own = sorted((d, r["sensors"][0]) for d, r in zip(at, results, strict=True) if d is not None)
    if len(own) < 2:
        return False
    distance = [100 * d for d, _ in own]
    published = np.genfromtxt(
        Path(DATA_DIR) / "data" / "paper" / "distance_phase_std.csv", delimiter=",", names=True
    )
    canvas = Figure(figsize=(7, 4), layout="constrained")
    axis = canvas.subplots()
    axis.errorbar(
        published["distance_from_rx_cm"],
        published["phase_std_deg"],
        [published["err_minus_deg"], published["err_plus_deg"]],
        fmt="s-",
        color="0.6",
        ms=4,
        label="published",
    )
    for method, style in zip(_METHODS, ("o-", None, "^--"), strict=True):
        if style is not None:
            rms = [sensor["methods"][method]["phase_rms_deg"] for _, sensor in own]
            axis.plot(distance, rms, style, label=method)
    axis.plot(distance, [sensor["bound_rms_deg"] for _, sensor in own], "k:", label="bound")
    axis.set_yscale("log")
    axis.set_xlabel("distance from the receiver (cm), antennas 4 m apart")
    axis.set_ylabel("phase rms (deg)")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    canvas.savefig(folder / "distance.png", dpi=100)
    return True


def _plot(result, path):
    """Force and location over time beside the truth, and how the errors are distributed."""
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(11, 7.5), layout="constrained")
    above, below = canvas.subfigures(2, 1, height_ratios=(2, 1))
    axes = above.subplots(2, 2, width_ratios=(2, 1))
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
    spectrum = below.subplots()
    spectrum.plot(result["spectrum"]["hz"], result["spectrum"]["db"], lw=0.6)
    spectrum.set_xlabel("Doppler frequency of the snapshots (Hz)")
    spectrum.set_ylabel("power (dB)")
    for axis in (*axes.flat, spectrum):
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
