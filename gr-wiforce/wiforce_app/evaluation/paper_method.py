# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's method on a capture: its estimator in this receiver, its inversion, its errors."""

import dataclasses

import numpy as np
from gnuradio.wiforce.estimation.off_state import corrected_phase_deg
from gnuradio.wiforce.signal.carrier import wrap_deg

from ..read import read_capture
from .error_summary import calibration_bias_deg, summary

_ESTIMATOR = "paper"


def paper_changes(recording, scene):
    """Change of every group since the first, complex of magnitude 1; shape (groups, 2S).

    Fourier sums at the lines 1 and 4, each group relative to the previous one (paper, section 3.3),
    accumulated. Of the first receive antenna, because the paper has one.
    """
    scene = dataclasses.replace(
        scene,
        phase_group=dataclasses.replace(scene.phase_group, estimator=_ESTIMATOR),
        environment=dataclasses.replace(scene.environment, receive_antennas=1),
    )
    changes = []
    read_capture(
        recording,
        scene,
        on_reading=lambda reading: None,
        on_groups=lambda groups: changes.append(groups.ratios),
    )
    return np.concatenate(changes)


def paper_errors(scene, index, changes, truth, detrend):
    """Errors in groups with a steady touch; the method is given the true times of touch.

    Parameters
    ----------
    scene : Scene
    index : int
        Number of the sensor in the scene.
    changes : ndarray of complex, shape (groups, 2S)
    truth : sequence of dict
        Truth rows of the sensor, one per group.
    detrend : bool
        Whether to subtract the straight line through the untouched reference first, which
        removes a constant clock offset.

    Returns
    -------
    dict
        See `summary`.
    """
    count = min(len(changes), len(truth))
    angles = np.unwrap(np.angle(changes[:count, 2 * index : 2 * index + 2]), axis=0)
    if detrend:
        angles = _detrended(angles, int(scene.reference_s / scene.group_period_s))
    sensor = scene.sensors[index]
    model, frequency = sensor.load_model(scene), scene.radio.center_frequency_hz
    phases, _ = corrected_phase_deg(
        np.exp(1j * angles), model.untouched_deg(frequency), sensor.off_reflection
    )
    steady = _steady([row["touch"] == 1 for row in truth[:count]])
    if not steady.any():
        return {}
    kept = [row for row, keep in zip(truth, steady, strict=False) if keep]
    true_deg = np.array([[row["phase1_deg"], row["phase2_deg"]] for row in kept])
    found = model.invert(phases[steady], frequency_hz=frequency)
    force = found.force_n - [row["force_n"] for row in kept]
    location = found.location_mm - [row["location_mm"] for row in kept]
    good = np.isfinite(force)
    phase_error = wrap_deg(phases[steady] - true_deg - calibration_bias_deg(scene, index))
    return summary(phase_error, force[good], location[good])


def _detrended(angles, reference_groups):
    """Angles (groups, 2) less the straight line through the reference groups."""
    times = np.arange(len(angles))
    reference = times < reference_groups
    if np.count_nonzero(reference) <= 2:
        return angles
    slope, start = np.polyfit(times[reference], angles[reference], 1)
    return angles - np.outer(times, slope) - start


def _steady(touch):
    """Groups that are touched and whose neighbours are touched."""
    touch = np.array(touch, bool)
    steady = touch.copy()
    steady[1:-1] &= touch[:-2] & touch[2:]
    steady[[0, -1]] = False
    return steady
