# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture of the accuracy benchmark: loss to the bound over SNR."""

import numpy as np

from .cases import ESTIMATORS


def plot_losses(rows, wanted, path):
    """Loss of every estimator over gamma, in a still and in a moving scene.

    Parameters
    ----------
    rows : sequence of montecarlo.Row
    wanted : sequence of Case
        Whose rows they are; the still and the moving sweep are drawn.
    path : str or Path
    """
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
            of_case = {row.case: row for row in rows if row.estimator == estimator}
            losses = np.array([of_case[case.name].loss_db for case in chosen], float)
            for end, style in ((0, "-o"), (1, "--s")):
                if len(losses):
                    label = f"{estimator}, end {end + 1}"
                    axis.plot(gammas, losses[:, end], style, ms=4, color=f"C{color}", label=label)
        axis.set_title(title, fontsize=10)
        axis.set_xlabel("gamma = |a G|²/σ² per subcarrier and snapshot (dB)")
        axis.set_yscale("symlog", linthresh=2, subs=(2, 5))
        axis.set_yticks([0, 1, 2, 5, 10, 20, 50], ["0", "1", "2", "5", "10", "20", "50"])
        axis.set_ylim(-0.7, 90)
        axis.grid(alpha=0.3)
    panels[0].set_ylabel("loss to the Cramer-Rao bound (dB)")
    lines, labels = panels[0].get_legend_handles_labels()
    # matplotlib 3.6 knows no place outside the panels: room is left for the legend.
    canvas.get_layout_engine().set(rect=(0, 0.1, 1, 0.9))
    canvas.legend(lines, labels, loc="lower center", ncols=len(ESTIMATORS), fontsize=8)
    canvas.savefig(path, dpi=110)
