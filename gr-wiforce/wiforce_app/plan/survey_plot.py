# SPDX-License-Identifier: GPL-3.0-or-later
"""Picture of a survey: the Doppler spectrum with everything that was found in it."""

import numpy as np
from gnuradio.wiforce.io.palette import FAINT, INK, SERIES
from gnuradio.wiforce.signal.lines import aliased_hz

from ..shell.plots import legend_below, save_picture

_MARKERS = "ovsDP*Xd"
# The first two are of the tags and of what the weights reject.
_FOUND = SERIES[2:]
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

    ``plan``: adapted to the room.
    """
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(10, 8), layout="constrained")
    axis, slow = canvas.subplots(2, 1, height_ratios=(3, 2))
    khz = survey.frequency_hz / 1e3
    level = 10 * np.log10(np.maximum(survey.spectrum, 1e-3))
    axis.plot(khz, level, lw=0.7, color=FAINT, label="spectrum of the untouched reference")
    own = (survey.own > _VISIBLE) & (level > _STANDS_OUT_DB)
    own &= survey.spectrum < 2 + _STRONGER * survey.own
    own[1:-1] &= (level[1:-1] >= level[:-2]) & (level[1:-1] >= level[2:])  # tops of lines
    around = np.convolve(own, np.ones(2 * _REACH + 1), "same") > 0
    axis.plot(
        khz,
        np.where(around, level, np.nan),
        lw=0.9,
        color=SERIES[0],
        label="higher and aliased lines of the scene's tags",
    )
    axis.axhline(0, color=INK, lw=1.0, ls="--", label="noise floor")
    if plan.clutter_hz:
        axis.axvspan(
            0,
            plan.clutter_hz / 1e3,
            color=SERIES[1],
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
            color=SERIES[0],
            marker=_OWN_MARKERS[index % len(_OWN_MARKERS)],
        )
    for index, finding in enumerate(found):
        style = {
            "color": _FOUND[index % len(_FOUND)],
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
    _plot_slow(slow, survey, found, plan)
    legend_below(canvas, *axis.get_legend_handles_labels(), ncols=2)
    save_picture(canvas, path)


def _plot_slow(axis, survey, found, plan):
    """Plot the frequencies below the lines of all tags, where people and machines move."""
    hertz = survey.frequency_hz[1:]
    level = 10 * np.log10(np.maximum(survey.spectrum[1:], 1e-3))
    top = min([clock.clock_hz for clock in plan.clocks], default=hertz[-1])
    axis.plot(hertz, level, lw=0.7, color=FAINT)
    axis.axhline(0, color=INK, lw=1.0, ls="--")
    if plan.clutter_hz:
        axis.axvspan(hertz[0], plan.clutter_hz, color=SERIES[1], alpha=0.25, lw=0)
    for index, finding in enumerate(found):
        if finding.kind == "clutter":
            axis.axvline(finding.frequency_hz, color=_FOUND[index % len(_FOUND)], lw=1.2)
    axis.set_xscale("log")
    axis.xaxis.set_major_formatter("{x:g}")
    axis.set_xlim(hertz[0], top)
    axis.set_ylim(_LOWEST_DB, float(level[hertz <= top].max()) + 5)
    axis.set_xlabel("frequency below the lines of the tags (Hz)")
    axis.set_ylabel("the same power (dB)")
    axis.grid(alpha=0.3)


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
