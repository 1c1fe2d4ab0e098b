# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene as an experiment: simulated, read by this receiver and the paper's method, scored."""

import tempfile
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
from gnuradio.wiforce.estimation.capture.folded_groups import frame_settings
from gnuradio.wiforce.estimation.clocks.tracked_tag import WIDEST_PPM
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.phases.off_state import corrected_phase_deg
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.text.textfile import read_yaml
from gnuradio.wiforce.planning.expected import expect
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.signal.weights import tones_of
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.simulation.truth import score, steady_rows, truth_rows
from gnuradio.wiforce.wiforce_kernels import folded_reader
from scipy.fft import fft

from ..read.recordings import read_capture
from .published import FOLDER

# The paper's method with the constant offset of the tag's clock removed.
CORRECTED = "paper, clock offset removed"
_BATCH = 64  # groups
# The cause that the file of a scene of the paper itself holds, in ``simulation.tags``.
OWN = "clock jitter"


def run(scene_name, work_folder):
    """Simulate, read and score a scene, with a capture in a folder that is deleted; for JSON.

    Per sensor: errors, of the paper's method with and without the clock's offset as well, and those
    of the plan; ``causes``: errors with each disturbance that explains a
    published figure. Phase errors compare changes with the mean reflection of a group; calibration
    errors and changes within it are part of the others only.
    """
    scene = load_scene(scene_name)
    with simulated(scene, work_folder) as (recording, truth):
        sensors, readings = _read(scene, recording, truth)
    return {
        "scene": str(scene_name),
        "sensors": sensors,
        "sum": _sum_of_forces(scene, readings, truth),
        "causes": _causes(scene_name, scene, sensors[0], work_folder),
    }


@contextmanager
def simulated(scene, work_folder):
    """A temporary capture of a scene: the recording, and rows of truth."""
    with tempfile.TemporaryDirectory(dir=work_folder, prefix=".capture-") as folder:
        capture = Path(folder) / "capture"
        simulate(scene, capture)
        yield open_capture(capture), mean_truth(scene)


def _read(scene, recording, truth):
    """Results of every sensor, and all readings."""
    readings = []
    read_capture(recording, scene, readings.append)
    scores = scored(scene, readings, truth)
    changes, expected = paper_changes(recording, scene), expect(plan(scene))
    sensors = []
    for i, sensor in enumerate(scene.sensors):
        rows = [row for row in truth if row["sensor"] == sensor.name]
        methods = {"ours": pooled_summary([scores[i]])}
        for method, detrend in (("paper", False), (CORRECTED, True)):
            methods[method] = paper_errors(scene, i, changes, rows, detrend)
        sensors.append(
            {
                "sensor": sensor.name,
                "methods": methods,
                "flagged": scores[i].flagged,
                "bound_rms_deg": float(np.sqrt(np.mean(np.square(expected[i].phase_std_deg)))),
                "radio_noise": scene.simulation.radio_noise is not None,
                "expected": {
                    "phase_deg": expected[i].phase_error_deg,
                    "force_n": expected[i].force_error_n,
                    "location_mm": expected[i].location_error_mm,
                },
            }
        )
    return sensors, readings


def _causes(scene_name, scene, own, work_folder):
    """Errors by cause; empty where the scene explains no published figure."""
    found = {}
    for cause, change in other_causes(scene_name).items():
        disturbed = with_cause(scene, change)
        with simulated(disturbed, work_folder) as captured:
            found[cause] = _errors(_read(disturbed, *captured)[0][0])
    return {OWN: _errors(own), **found} if found else {}


def other_causes(name):
    """Changes of ``simulation`` that replace a shipped scene's own disturbance, by cause."""
    return read_yaml(FOLDER / "causes.yaml").get(name, {})


def with_cause(scene, change):
    """A scene with other keys of ``simulation`` and, unless they have some, ideal tags."""
    content = scene.as_dict()
    content["simulation"] |= {"tags": [], **change}
    return load_scene(content)


def _errors(sensor):
    kept = ("phase_rms_deg", "force_n", "location_mm")
    errors = {
        name: {key: sensor["methods"][method].get(key) for key in kept}
        for name, method in (("ours", "ours"), ("paper", CORRECTED))
    }
    read = sensor["methods"]["ours"].get("read", 0)
    return {**errors, "flagged": sensor["flagged"], "read": read}


def mean_truth(scene):
    """Rows of truth with the phases of the mean reflection of each group, not of its centre."""
    channel = AirChannel(scene)
    tags = channel.sensors
    truth = [row for row in truth_rows(scene, channel) if row["sensor"] in tags]
    for row in truth:
        pressed = tags[row["sensor"]].pressed
        phases = pressed.mean_phases_deg([row["time_s"]], scene.group_period_s)[0]
        row["phase1_deg"], row["phase2_deg"] = phases
    return truth


def _sum_of_forces(scene, readings, truth):
    """Median error of the sum of all forces while all sensors are touched; None for one."""
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


def _plan_without_survey(scene):
    """The plan of a scene alone, of clocks that need no survey."""
    sensors = [
        replace(sensor, clock_tolerance_ppm=min(sensor.clock_tolerance_ppm, WIDEST_PPM))
        for sensor in scene.sensors
    ]
    return plan(replace(scene, sensors=tuple(sensors)))


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
    """The `_summary` of errors under steady touches; ``detrend`` removes a clock's offset."""
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
    phase_error = wrap_deg(phases[steady] - true_deg - _calibration_bias_deg(scene, index))
    return _summary(phase_error, force[good], location[good])


def _detrended(angles, reference_groups):
    """Angles (groups, 2) less the straight line through the reference groups."""
    times = np.arange(len(angles))
    reference = times < reference_groups
    if np.count_nonzero(reference) <= 2:
        return angles
    slope, start = np.polyfit(times[reference], angles[reference], 1)
    return angles - np.outer(times, slope) - start


def scored(scene, readings, truth):
    """A Score per sensor, whose phase errors are without those of the untouched phases' model."""
    found = [score(readings, truth, sensor.name) for sensor in scene.sensors]
    return [
        replace(
            each, phase_error_deg=wrap_deg(each.phase_error_deg - _calibration_bias_deg(scene, i))
        )
        for i, each in enumerate(found)
    ]


def pooled_summary(scores):
    """The `_summary` of all errors of some scores."""
    names = ("phase_error_deg", "force_error_n", "location_error_mm")
    return _summary(*(np.concatenate([getattr(each, n) for each in scores]) for n in names))


def _summary(phase_deg, force_n, location_mm):
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


def _calibration_bias_deg(scene, index):
    """Error of the untouched phases in the reader's model; shape (2,)."""
    frequency = scene.radio.center_frequency_hz
    known = scene.sensors[index].load_model(scene).untouched_deg(frequency)
    true = scene.load_model(scene.simulation.tags[index].truth_model).untouched_deg(frequency)
    return wrap_deg(np.subtract(known, true))
