# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene as an experiment: simulated, read by us and by the paper's method, scored."""

import dataclasses
import tempfile
from pathlib import Path

import numpy as np
from gnuradio.wiforce.angles import wrap_deg
from gnuradio.wiforce.capture import open_capture
from gnuradio.wiforce.estimation.off_state import corrected_phase_deg
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.channel import AirChannel
from gnuradio.wiforce.scene.expected import expect, why_not_readable
from gnuradio.wiforce.scene.plan import plan
from gnuradio.wiforce.scene.schema import about_scene
from gnuradio.wiforce.scene.score import read_truth, score
from gnuradio.wiforce.scene.simulator import second_antenna, simulate
from gnuradio.wiforce.waveform import FFT_LENGTH

from .bench.chain import SnapshotChain
from .read import read_capture

_SPECTRUM_LENGTH = 5000  # snapshots


def run(scene_name, work_folder):
    """Simulates and reads a scene; the capture is deleted.

    Parameters
    ----------
    scene_name : str
        Shipped scene or file.
    work_folder : path
        For the capture while it is needed.

    Returns
    -------
    dict
        Plain values that JSON can hold; per sensor the errors of ours, of the paper's method as
        published and with the constant clock offset removed, what the plan expected, and the
        groups' readings and the spectrum of the snapshots for pictures. Phase errors are those of
        the change against the untouched sensor, and of the group's mean reflection: what a
        calibration errs by in the untouched phases, and how the force changes about the group's
        centre, count in force and location.
    """
    scene = load_scene(scene_name)
    with tempfile.TemporaryDirectory(dir=work_folder, prefix=".capture-") as folder:
        capture = Path(folder) / "capture"
        simulate(scene, capture)
        if scene.environment.receive_antennas == 2:
            simulate(scene, second_antenna(capture), antenna=1)
        truth = _with_mean_phases(scene, read_truth(f"{capture}.truth.csv"))
        recording = open_capture(capture)
        readings = []
        read_capture(recording, scene, readings.append)
        spectrum = Spectrum(scene)
        paper = _paper_ratios(recording, scene, spectrum)
    settings = plan(scene)
    expected = expect(scene, settings)
    sensors = [
        _sensor(scene, i, readings, paper, truth, expected[i]) for i in range(len(scene.sensors))
    ]
    return {
        "scene": str(scene_name),
        "about": about_scene(scene_name),
        "seed": scene.simulation.seed,
        "reference_s": scene.reference_s,
        "sensors": sensors,
        "sum": _sum_of_forces(scene, readings, truth),
        "spectrum": spectrum.as_dict(),
    }


def _with_mean_phases(scene, truth):
    """Truth rows, their phases those of the group's mean reflection instead of its centre's."""
    tags = AirChannel(scene).sensors
    for row in truth:
        pressed = tags[row["sensor"]].pressed
        phases = pressed.mean_phases_deg([row["time_s"]], scene.group_period_s)[0]
        row["phase1_deg"], row["phase2_deg"] = phases
    return truth


class Spectrum:
    """Power of the snapshots over Doppler frequency, averaged over subcarriers and stretches."""

    def __init__(self, scene):
        self._period_s = scene.snapshot_period_s
        self._power, self._stretches, self._waiting = 0.0, 0, []

    def add(self, snapshots):
        """Takes H (n, K) of one group."""
        self._waiting.append(snapshots)
        if sum(map(len, self._waiting)) < _SPECTRUM_LENGTH:
            return
        stretch = np.concatenate(self._waiting)[:_SPECTRUM_LENGTH]
        window = np.kaiser(len(stretch), 14)[:, None]
        lines = np.fft.fft(stretch * window, axis=0) / window.sum()
        self._power = self._power + np.mean(np.abs(lines) ** 2, axis=1)
        self._stretches += 1
        self._waiting = []

    def as_dict(self):
        """Frequencies in Hz and levels in dB, rising from minus to plus half the snapshot rate."""
        if not self._stretches:
            return {"hz": [], "db": []}
        level = 10 * np.log10(np.maximum(self._power / self._stretches, 1e-30))
        hz = np.fft.fftfreq(_SPECTRUM_LENGTH, self._period_s)
        return {
            "hz": np.fft.fftshift(hz).round(2).tolist(),
            "db": np.fft.fftshift(level).round(2).tolist(),
        }


def _sensor(scene, index, readings, paper, truth, expected):
    name = scene.sensors[index].name
    ours = score(readings, truth, name)
    own = [reading for reading in readings if reading.sensor == name]
    rows = [row for row in truth if row["sensor"] == name]
    bias = _calibration_bias_deg(scene, index)
    phase_error = wrap_deg(ours.phase_error_deg - bias)
    methods = {"ours": _summary(phase_error, ours.force_error_n, ours.location_error_mm)}
    for method, detrend in (("paper", False), ("paper, clock offset removed", True)):
        methods[method] = _paper_errors(scene, index, paper, rows, detrend)
    return {
        "sensor": name,
        "model": scene.sensors[index].model,
        "truth_model": scene.simulation.tags[index].truth_model,
        "methods": methods,
        "missed": ours.missed,
        "false": ours.false,
        "flagged": ours.flagged,
        "unflagged": sum(r.force_n is not None and not r.flags for r in own),
        "not_readable": why_not_readable(scene, index),
        "flags": sorted({flag for reading in own for flag in reading.flags}),
        "bound_rms_deg": float(np.sqrt(np.mean(np.square(expected.phase_std_deg)))),
        "expected": {
            "phase_deg": expected.phase_error_deg,
            "force_n": expected.force_error_n,
            "location_mm": expected.location_error_mm,
        },
        "readings": [[r.time_s, r.touch, r.force_n, r.location_mm, bool(r.flags)] for r in own],
        "truth": [[r["time_s"], r["touch"], r["force_n"], r["location_mm"]] for r in rows],
    }


def _summary(phase, force, location):
    """Medians, 90th percentiles, phase rms; empty where nothing was read."""
    if not len(phase):
        return {}
    found = {
        "phase_deg": float(np.median(np.abs(phase))),
        "phase_rms_deg": float(np.sqrt(np.mean(phase**2))),
    }
    for name, error in (("force_n", force), ("location_mm", location)):
        if len(error):
            found[name] = float(np.median(np.abs(error)))
            found[f"{name}_90"] = float(np.percentile(np.abs(error), 90))
            found[f"{name}_errors"] = np.abs(error).tolist()
    return found


def _paper_ratios(recording, scene, spectrum):
    """R (groups, 2S) of the paper's method: plain sums at lines 1 and 4, group to group."""
    phase_group = dataclasses.replace(scene.phase_group, estimator="paper")
    settings = plan(dataclasses.replace(scene, phase_group=phase_group))
    chain, waveform = SnapshotChain(settings), settings.waveform
    ratios = []
    codes, per_group = np.memmap(recording.path, "<i2", "r"), 2 * scene.group_samples
    for group in range(len(codes) // per_group):
        part = codes[group * per_group : (group + 1) * per_group]
        snapshots = _channel(part, waveform)
        spectrum.add(snapshots)
        ratios += [ratio for _, ratio in chain.process(group, snapshots)]
    ratios += [ratio for _, ratio in chain.flush()]
    return np.array(ratios)


def _channel(codes, waveform):
    """H (N, K) of one group's samples (I Q I Q): fold, FFT, divide."""
    samples = codes.astype(np.float32).view(np.complex64)
    frames = samples.reshape(-1, waveform.frame_length)
    first = waveform.first_averaged
    averaged = frames[:, first : first + waveform.repetitions * FFT_LENGTH]
    folded = averaged.reshape(len(frames), waveform.repetitions, FFT_LENGTH).mean(axis=1)
    return (np.fft.fft(folded, axis=1) * waveform.equalizer())[:, waveform.bins]


def _paper_errors(scene, index, ratios, rows, detrend):
    """Errors of the paper's method where the sensor is steadily touched, told when that is."""
    count = min(len(ratios), len(rows))
    changes = np.unwrap(np.angle(ratios[:count, 2 * index : 2 * index + 2]), axis=0)
    if detrend:
        times = np.arange(count)
        reference = times < int(scene.reference_s / scene.group_period_s)
        if np.count_nonzero(reference) > 2:
            slope = np.polyfit(times[reference], changes[reference], 1)
            changes = changes - np.outer(times, slope[0]) - slope[1]
    sensor = scene.sensors[index]
    model, frequency = sensor.load_model(scene), scene.radio.center_frequency_hz
    phases, _ = corrected_phase_deg(
        np.exp(1j * changes), model.untouched_deg(frequency), sensor.off_reflection
    )
    touch = np.array([row["touch"] == 1 for row in rows[:count]])
    steady = touch.copy()
    steady[1:-1] &= touch[:-2] & touch[2:]
    steady[[0, -1]] = False
    if not steady.any():
        return {}
    kept = [row for row, keep in zip(rows, steady, strict=False) if keep]
    truth = np.array([[row["phase1_deg"], row["phase2_deg"]] for row in kept])
    found = model.invert(phases[steady], frequency_hz=frequency)
    force = found.force_n - [row["force_n"] for row in kept]
    location = found.location_mm - [row["location_mm"] for row in kept]
    good = np.isfinite(force)
    phase_error = wrap_deg(phases[steady] - truth - _calibration_bias_deg(scene, index))
    return _summary(phase_error, force[good], location[good])


def _calibration_bias_deg(scene, index):
    """By how much the reader's untouched phases differ from the true ones; shape (2,)."""
    frequency = scene.radio.center_frequency_hz
    known = scene.sensors[index].load_model(scene).untouched_deg(frequency)
    true = scene.load_model(scene.simulation.tags[index].truth_model).untouched_deg(frequency)
    return wrap_deg(np.subtract(known, true))


def _sum_of_forces(scene, readings, truth):
    """Median error of the sum of all sensors' forces while all are touched; None for one."""
    names = scene.sensor_names
    if len(names) < 2:
        return None
    known = {(round(row["time_s"], 4), row["sensor"]): row["force_n"] for row in truth}
    by_time = {}
    for reading in readings:
        if reading.touch == 1 and reading.force_n is not None and not reading.flags:
            by_time.setdefault(round(reading.time_s, 4), {})[reading.sensor] = reading.force_n
    errors = [
        sum(forces.values()) - sum(known[time, name] for name in names)
        for time, forces in by_time.items()
        if len(forces) == len(names)
    ]
    return float(np.median(np.abs(errors))) if errors else None
