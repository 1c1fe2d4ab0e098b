# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture of the error distributions on the published trials."""

import numpy as np
from gnuradio.wiforce.io.palette import SERIES

from ..shell.plots import legend_below, save_picture


def plot_error_distributions(scores, forms, path):
    """Plot cumulative distributions of force and location errors on the published trials.

    ``forms``: the selected form of the curves, by carrier.
    """
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(10, 3.4 * len(forms)), layout="constrained")
    axes = canvas.subplots(len(forms), 2, squeeze=False)
    methods = list(dict.fromkeys(score.method for score in scores))
    for row, (frequency, form) in zip(axes, forms.items(), strict=True):
        own = [s for s in scores if s.press.frequency_hz == frequency and s.form == form]
        _plot_distribution(row[0], own, methods, "force_error", "force error (N)")
        _plot_distribution(row[1], own, methods, "location_error", "location error (mm)")
        row[0].set_ylabel(f"{frequency / 1e6:g} MHz, {form}\nshare of the readings")
    legend_below(canvas, *axes[0, 0].get_legend_handles_labels(), ncols=len(methods))
    canvas.suptitle("Published wireless trials (dashed: with one wireless press per location)")
    save_picture(canvas, path)


def _plot_distribution(axis, scores, methods, what, label):
    for i, method in enumerate(methods):
        for refined in (False, True):
            own = [s for s in scores if s.method == method and s.refined == refined]
            errors = np.sort(np.concatenate([getattr(score, what) for score in own]))
            if not np.any(errors):
                continue  # the location was known
            part = np.arange(1, errors.size + 1) / errors.size
            axis.step(
                errors,
                part,
                "--" if refined else "-",
                color=SERIES[i % len(SERIES)],
                where="post",
                linewidth=1.2,
                label=None if refined else method,
            )
    axis.set_xlim(0, 3)
    axis.set_ylim(0, 1)
    axis.set_xlabel(label)
    axis.grid(alpha=0.3)
