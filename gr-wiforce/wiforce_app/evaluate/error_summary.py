# SPDX-License-Identifier: GPL-3.0-or-later
"""Error statistics of a method in a scene, and the contribution of the calibration."""

import numpy as np
from gnuradio.wiforce.signal.carrier import wrap_deg


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
    """A number as text for a table; empty for None."""
    return "" if value is None else f"{value:.3g}"


def calibration_bias_deg(scene, index):
    """Error of the untouched phases in the reader's model; shape (2,)."""
    frequency = scene.radio.center_frequency_hz
    known = scene.sensors[index].load_model(scene).untouched_deg(frequency)
    true = scene.load_model(scene.simulation.tags[index].truth_model).untouched_deg(frequency)
    return wrap_deg(np.subtract(known, true))
