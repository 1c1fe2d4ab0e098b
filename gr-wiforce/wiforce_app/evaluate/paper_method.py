# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's method on a capture: its estimator in this receiver, its inversion, its errors."""

from dataclasses import replace

import numpy as np
from gnuradio.wiforce.estimation.capture.folded_groups import frame_settings
from gnuradio.wiforce.estimation.clocks.tracked_tag import WIDEST_PPM
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.phases.off_state import corrected_phase_deg
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.receiver.recording import RecordingReader
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.signal.weights import tones_of
from gnuradio.wiforce.simulation.truth import steady_rows
from gnuradio.wiforce.wiforce_kernels import folded_reader
from scipy.fft import fft

from .error_summary import calibration_bias_deg, summary

_BATCH = 64  # groups


def _plan_without_survey(scene):
    """The plan of a scene alone, of clocks that need no survey."""
    sensors = [
        replace(sensor, clock_tolerance_ppm=min(sensor.clock_tolerance_ppm, WIDEST_PPM))
        for sensor in scene.sensors
    ]
    return plan(replace(scene, sensors=tuple(sensors)))


def read_without_survey(recording, scene):
    """Readings by the plan of a scene alone, of clocks that need no survey."""
    reader = RecordingReader(recording, _plan_without_survey(scene), 0, survey=False)
    return [reading for batch in reader for reading in batch]


def paper_changes(recording, scene):
    """Accumulated changes (groups, 2S) by Fourier sums at lines 1 and 4 (paper, section 3.3).

    Of all snapshots, as the paper: without those that interference hit, the sums would leak.
    """
    settings = _plan_without_survey(
        replace(
            scene,
            phase_group=replace(scene.phase_group, estimator="paper"),
            environment=replace(scene.environment, receive_antennas=1),
        )
    )
    changes = []
    receiver = Receiver(
        settings, derotated=False, on_groups=lambda groups: changes.append(groups.ratios)
    )
    length, waveform = settings.group_length, settings.waveform
    factors = waveform.equalizer().astype(np.complex64)
    frames, first = folded_reader(**frame_settings(recording, waveform, frame_offset=0)), 0
    while count := len(folded := frames.read(_BATCH * length)["folded"]) // length:
        channels = (fft(folded[: count * length], axis=1) * factors)[:, waveform.bins]
        tones = [tones_of(settings.table.weights, group) for group in np.split(channels, count)]
        receiver.process(Groups(first + np.arange(count), np.stack(tones)))
        first += count
    receiver.finish()
    return np.concatenate(changes)


def paper_errors(scene, index, changes, truth, detrend):
    """The `summary` of errors under steady touches; ``detrend`` removes a clock's offset."""
    count = min(len(changes), len(truth))
    angles = np.unwrap(np.angle(changes[:count, 2 * index : 2 * index + 2]), axis=0)
    if detrend:
        angles = _detrended(angles, int(scene.reference_s / scene.group_period_s))
    sensor = scene.sensors[index]
    model, frequency = sensor.load_model(scene), scene.radio.center_frequency_hz
    phases, _ = corrected_phase_deg(
        np.exp(1j * angles), model.untouched_deg(frequency), sensor.off_reflection
    )
    kept = steady_rows(truth[:count])
    if not kept:
        return {}
    steady = [truth.index(row) for row in kept]
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
