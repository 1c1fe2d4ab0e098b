# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of readings of a scene, their statistics, and the contribution of the calibration."""

from dataclasses import replace

import numpy as np
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.simulation.truth import score


def scored(scene, readings, truth):
    """A Score per sensor, whose phase errors are without those of the untouched phases' model."""
    found = [score(readings, truth, sensor.name) for sensor in scene.sensors]
    return [
        replace(
            each, phase_error_deg=wrap_deg(each.phase_error_deg - calibration_bias_deg(scene, i))
        )
        for i, each in enumerate(found)
    ]


def pooled_summary(scores):
    """The `summary` of all errors of some scores."""
    names = ("phase_error_deg", "force_error_n", "location_error_mm")
    return summary(*(np.concatenate([getattr(each, n) for each in scores]) for n in names))


def summary(phase_deg, force_n, location_mm):
    """Medians, 90th percentiles, phase rms and number of errors; empty without readings."""
    if not len(phase_deg):
        return {}
    found = {
        "phase_deg": float(np.median(np.abs(phase_deg))),
        "phase_rms_deg": float(np.sqrt(np.mean(phase_deg**2))),
        "read": len(force_n),
    }
    for name, error in (("force_n", force_n), ("location_mm", location_mm)):
        if len(error):
            found[name] = float(np.median(np.abs(error)))
            found[f"{name}_90"] = float(np.percentile(np.abs(error), 90))
    return found


def figure_text(value):
    """A number as text for a table, or none; what is text already stays."""
    if value is None:
        return ""
    return value if isinstance(value, str) else f"{value:.3g}"


def calibration_bias_deg(scene, index):
    """Error of the untouched phases in the reader's model; shape (2,)."""
    frequency = scene.radio.center_frequency_hz
    known = scene.sensors[index].load_model(scene).untouched_deg(frequency)
    true = scene.load_model(scene.simulation.tags[index].truth_model).untouched_deg(frequency)
    return wrap_deg(np.subtract(known, true))
