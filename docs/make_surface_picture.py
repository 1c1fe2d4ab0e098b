#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws docs/images/surface.png: a spreading law, and presses with all strips and without one.

build/run python3 docs/make_surface_picture.py
"""

from pathlib import Path

import numpy as np
from gnuradio.wiforce.gui.sensor_view import ellipse
from gnuradio.wiforce.io.palette import BEAM, INK, SERIES
from gnuradio.wiforce.io.readings import SurfaceReading
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.simulation.presses import plate_share
from gnuradio.wiforce.surface.estimator import SurfaceEstimator
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

PICTURE = Path(__file__).resolve().parent / "images" / "surface.png"
SCENE, LOST = "surface_four_strips", 1
COUNT, SEED, NOISE_DEG = 24, 3, 0.05


def main():
    settings = plan(SCENE)
    skin, plate = settings.skin, settings.require_scene().simulation.plate
    truth = settings.require_scene().load_model("line-915mhz")
    rng = np.random.default_rng(SEED)
    x = np.tile(np.linspace(24, 56, 6), 4) + rng.uniform(-2, 2, COUNT)
    y = np.repeat(np.linspace(2, 34, 4), 6) + rng.uniform(-3, 3, COUNT)
    force = rng.uniform(5, 9, COUNT)
    loads = force[:, None] * plate_share(y[:, None] - skin.y_mm, plate.reach_mm, skin.spacing_mm)
    phases = truth.phases_deg(loads, x[:, None], 915e6)
    phases += NOISE_DEG * rng.standard_normal(phases.shape)
    touched, std = loads >= truth.onset_force_n, np.full(phases.shape, NOISE_DEG)
    canvas = Figure(figsize=(12, 4.8), layout="constrained")
    law, whole, lost = canvas.subplots(1, 3, width_ratios=(1, 1.25, 1.25))
    draw_law(law, skin, plate)
    for axis, usable, title in (
        (whole, np.ones(touched.shape, bool), "four strips"),
        (lost, np.arange(4) != LOST, "one strip switched off"),
    ):
        usable = np.broadcast_to(usable, touched.shape)
        found = SurfaceEstimator(skin).read(phases, std, usable, touched)
        draw_plane(axis, skin, found, np.column_stack([force, x, y]), usable[0])
        axis.set_title(title)
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), ncols=2, fontsize=8)
    canvas.savefig(PICTURE, dpi=100)


def draw_law(axis, skin, plate):
    """The reader's law with its stated error, and what the plate does."""
    distance = np.linspace(-30, 30, 301)
    share, std = skin.spreading.mean_share(distance), skin.spreading.share_std
    axis.fill_between(distance, share - 2 * std, share + 2 * std, color=SERIES[0], alpha=0.2, lw=0)
    axis.plot(distance, share, color=SERIES[0], label="the reader's law, two std")
    pressed = plate_share(distance, plate.reach_mm, skin.spacing_mm)
    axis.plot(distance, pressed, "--", color=INK, label="the simulated plate")
    axis.set_xlabel("distance across (mm)")
    axis.set_ylabel("share of the force")
    axis.set_ylim(-0.08, 0.85)
    axis.set_title("what a strip bears")
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.13), fontsize=8)


def draw_plane(axis, skin, found, presses, usable):
    """Strips, true presses as crosses, readings as dots with two standard deviations."""
    for strip, on in zip(skin.strips, usable, strict=True):
        style = {"ls": "-", "label": "strip"} if on else {"ls": ":", "label": "strip that is off"}
        if style["label"] in axis.get_legend_handles_labels()[1]:
            del style["label"]
        axis.axhline(strip.y_mm, color=BEAM, lw=4, zorder=0, **style)
    for i, (_, x, y) in enumerate(presses):
        once = i == 0
        axis.plot(x, y, "+", color=INK, ms=8, label="press" if once else None)
        mean, c = found.mean[i, 0], found.covariance[i, 0]
        stds = dict(zip(("location_std_mm", "y_std_mm"), np.sqrt(np.diag(c))[1:], strict=True))
        reading = SurfaceReading(0.0, "", cov_x_y=c[1, 2], **stds)
        semi, angle = ellipse(reading)
        size = 2 * semi[0], 2 * semi[1]
        axis.add_patch(Ellipse(mean[1:], *size, angle=angle, fc=SERIES[0], alpha=0.25))
        axis.add_patch(Ellipse(mean[1:], *size, angle=angle, fc="none", ec=SERIES[0], lw=0.8,
                               label="two standard deviations" if once else None))  # fmt: skip
        axis.plot(mean[1], mean[2], "o", color=SERIES[1], ms=1.1 * np.sqrt(mean[0]), alpha=0.8,
                  label="reading" if once else None)  # fmt: skip
    axis.set_xlim(18, 62)
    axis.set_ylim(-18, 46)
    axis.set_aspect("equal")
    axis.set_xlabel("x (mm)")
    axis.set_ylabel("y (mm)")


if __name__ == "__main__":
    main()
