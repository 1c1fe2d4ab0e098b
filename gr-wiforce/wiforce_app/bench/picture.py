# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of the benchmarks: loss to the bound over SNR, and scaling."""

import numpy as np
from gnuradio.wiforce.io.palette import SERIES, series_style

from ..shell.plots import legend_below, save_picture
from .cases import ESTIMATORS


def plot_losses(rows, wanted, path):
    """Plot the loss of every estimator over gamma, in the static and in the moving sweep."""
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(10, 5), layout="constrained")
    panels = canvas.subplots(1, 2, sharey=True)
    sweeps = {
        "still scene, static +70 dB": "still, ",
        "walker and fan +30 dB, static +70 dB": "walker and fan +30 dB, gamma",
    }
    for axis, (title, start) in zip(panels, sweeps.items(), strict=True):
        chosen = [case for case in wanted if case.name.startswith(start)]
        gammas = [case.gamma_db for case in chosen]
        for color, estimator in enumerate(ESTIMATORS):
            of_case = {row["case"]: row for row in rows if row["estimator"] == estimator}
            losses = np.array([of_case[case.name]["loss_db"] for case in chosen], float)
            for end, style in ((0, "-o"), (1, "--s")):
                if len(losses):
                    label = f"{estimator}, end {end + 1}"
                    color_of = SERIES[color % len(SERIES)]
                    axis.plot(gammas, losses[:, end], style, ms=4, color=color_of, label=label)
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("gamma = |a G|²/σ² per subcarrier and snapshot (dB)")
        axis.set_yscale("symlog", linthresh=2, subs=(2, 5))
        axis.set_yticks([0, 1, 2, 5, 10, 20, 50], ["0", "1", "2", "5", "10", "20", "50"])
        axis.set_ylim(-0.7, 90)
        axis.grid(alpha=0.3)
    panels[0].set_ylabel("loss to the Cramer-Rao bound (dB)")
    lines, labels = panels[0].get_legend_handles_labels()
    legend_below(canvas, lines, labels, ncols=len(ESTIMATORS))
    save_picture(canvas, path)


def plot_scaling(result, path, labels):
    """Plot the times of the receiver along each axis, both logarithmic, one panel per axis."""
    from matplotlib.figure import Figure

    by_axis = {axis: [] for axis in labels}
    for row in result["rows"]:
        by_axis[row["setting"]["axis"]].append(row)
    drawn = [axis for axis, rows in by_axis.items() if rows]
    canvas = Figure(figsize=(3.6 * max(len(drawn), 1) + 1, 4.6), layout="constrained")
    panels = canvas.subplots(1, max(len(drawn), 1), squeeze=False)[0]
    powers = {(g["axis"], g["quantity"]): g["exponent"] for g in result["growth"]}
    for panel, axis in zip(panels, drawn, strict=False):
        x = [row["value"] for row in by_axis[axis]]
        for number, quantity in enumerate(_SCALING_NAMES):
            y = np.array([row[quantity] for row in by_axis[axis]])
            # All in milliseconds.
            y = y * {"start_s": 1e3, "group_us": 1e-3}.get(quantity, 1.0)
            power = powers.get((axis, quantity))
            shown = "" if power is None else f"{power:.2f}"
            panel.plot(x, y, ms=4, label=shown, **series_style(number))
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_xticks(x, [f"{value:.0f}" for value in x])
        panel.set_xticks([], minor=True)
        panel.set_xlabel(labels[axis])
        panel.grid(alpha=0.3)
        panel.legend(
            title="exponent",
            fontsize=9,
            title_fontsize=9,
            loc="upper center",
            bbox_to_anchor=(0.5, -0.13),
            ncols=len(_SCALING_NAMES),
            columnspacing=0.8,
            handlelength=1.2,
            handletextpad=0.3,
            frameon=False,
        )
    panels[0].set_ylabel("processor time (ms)")
    legend_below(canvas, panels[0].get_lines(), _SCALING_NAMES.values(), ncols=len(_SCALING_NAMES))
    save_picture(canvas, path)


_SCALING_NAMES = {
    "start_s": "start-up",
    "samples_ms": "samples to tones, per second",
    "group_us": "tones to readings, per group",
    "groups_ms": "tones to readings, per second",
}
