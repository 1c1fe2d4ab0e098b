# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture of a survey: the Doppler spectrum with everything that was found in it."""

import numpy as np
from gnuradio.wiforce.signal.lines import aliased_hz

from ..shell.plots import save_picture

_MARKERS = "ovsDP*Xd"
_OWN_MARKERS = "^v<>"
_LOWEST_DB = -6.0
# Lines of the scene's tags are drawn where more than this part of the floor is expected, and lines
# are marked where they stand out by so many dB.
_VISIBLE, _STANDS_OUT_DB = 0.3, 3.0
# Lines of a real tag may be so much stronger than those of ideal switches.
_STRONGER = 4.0
# Half width of a line in the spectrum, in bins.
_REACH = 5


def plot_survey(survey, found, plan, path, title=""):
    """Plot the spectrum of a survey and label its components.

    Parameters
    ----------
    plan : Plan
        Adapted to the room.
    path : str or Path
        PNG, PDF or SVG.
    """
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(10, 6), layout="constrained")
    axis = canvas.subplots()
    khz = survey.frequency_hz / 1e3
    level = 10 * np.log10(np.maximum(survey.spectrum, 1e-3))
    axis.plot(khz, level, lw=0.7, color="0.45", label="spectrum of the untouched reference")
    own = (survey.own > _VISIBLE) & (level > _STANDS_OUT_DB)
    own &= survey.spectrum < 2 + _STRONGER * survey.own
    own[1:-1] &= (level[1:-1] >= level[:-2]) & (level[1:-1] >= level[2:])  # tops of lines
    around = np.convolve(own, np.ones(2 * _REACH + 1), "same") > 0
    axis.plot(
        khz,
        np.where(around, level, np.nan),
        lw=0.9,
        color="C0",
        label="higher and aliased lines of the scene's tags",
    )
    axis.axhline(0, color="k", lw=1.0, ls="--", label="noise floor")
    if plan.clutter_hz:
        axis.axvspan(
            0,
            plan.clutter_hz / 1e3,
            color="C1",
            alpha=0.25,
            lw=0,
            label=f"rejected by the weights, 0 to {plan.clutter_hz:.0f} Hz",
        )
    for index, (name, clock) in enumerate(
        zip(plan.require_scene().sensor_names, plan.clocks, strict=True)
    ):
        lines = [m * clock.clock_hz for m in range(1, plan.harmonics + 1)]
        _mark(
            axis,
            survey,
            lines,
            f"lines of '{name}' ({clock.clock_hz:g} Hz)",
            color="C0",
            marker=_OWN_MARKERS[index % len(_OWN_MARKERS)],
        )
    for index, finding in enumerate(found):
        style = {
            "color": f"C{2 + index % 8}",
            "marker": _MARKERS[index % len(_MARKERS)],
        }
        label = f"{finding.name}, {finding.level_db:+.1f} dB"
        if finding.kind == "clutter":
            axis.axvline(finding.frequency_hz / 1e3, color=style["color"], lw=1.2, label=label)
        else:
            _mark(axis, survey, finding.lines_hz, label, **style)
    axis.set_xlim(0, khz[-1])
    axis.set_ylim(_LOWEST_DB, float(level.max()) + 5)
    axis.set_xlabel("frequency (kHz)")
    axis.set_ylabel("power above the noise floor (dB)")
    axis.set_title(title, fontsize=11)
    axis.grid(alpha=0.3)
    axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.11), ncols=2, fontsize=9)
    save_picture(canvas, path)


def _mark(axis, survey, lines_hz, label, **style):
    """Mark lines just above the spectrum."""
    rate, step_hz = 1 / survey.snapshot_period_s, survey.frequency_hz[1]
    level = 10 * np.log10(np.maximum(survey.spectrum, 1e-3))
    marks = []
    for hertz in lines_hz:
        seen = abs(aliased_hz(hertz, rate))
        middle = int(round(seen / step_hz))
        top = level[max(0, middle - _REACH) : middle + _REACH + 1].max()
        if top > _STANDS_OUT_DB:
            marks.append((seen / 1e3, top + 1.5))
    axis.plot(*np.reshape(marks, (-1, 2)).T, ls="", ms=6, label=label, **style)
