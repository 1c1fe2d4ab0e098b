# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene as an experiment: simulated, read by several methods, scored."""

import tempfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.expected import expect, why_not_readable
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.load import about_scene
from gnuradio.wiforce.simulation.channel import AirChannel
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.simulation.truth import read_truth

from ..read.recordings import read_capture
from .causes import OWN, other_causes, with_cause
from .error_summary import pooled_summary, scored
from .paper_method import paper_changes, paper_errors, read_without_survey

# Rows of the report: this receiver by the plan alone, whatever is in the room, and the paper's
# method with the constant offset of the tag's clock removed.
UNSURVEYED = "ours, not surveyed"
CORRECTED = "paper, clock offset removed"


def run(scene_name, work_folder):
    """Simulate, read and score a scene, with a capture in a folder that is deleted; for JSON.

    Per sensor: errors with and without a survey, of the paper's method with and without the clock's
    offset, and those of the plan; ``causes``: errors with each disturbance that explains a
    published figure. Phase errors compare changes with the mean reflection of a group; calibration
    errors and changes within it are part of the others only.
    """
    scene = load_scene(scene_name)
    with simulated(scene, work_folder) as (recording, truth):
        sensors, readings = _read(scene, recording, truth, unsurveyed=True)
    return {
        "scene": str(scene_name),
        "about": about_scene(scene_name),
        "seed": scene.simulation.seed,
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
        truth = with_mean_phases(scene, read_truth(f"{capture}.truth.csv"))
        yield open_capture(capture), truth


def _read(scene, recording, truth, unsurveyed=False):
    """Results of every sensor, and all readings with a survey; ``unsurveyed``: also without one."""
    read = {"ours": []}
    read_capture(recording, scene, read["ours"].append)
    if unsurveyed:
        read[UNSURVEYED] = read_without_survey(recording, scene)
    found = {method: scored(scene, readings, truth) for method, readings in read.items()}
    changes, expected = paper_changes(recording, scene), expect(plan(scene))
    sensors = []
    for i, sensor in enumerate(scene.sensors):
        rows = [row for row in truth if row["sensor"] == sensor.name]
        own = {method: scores[i] for method, scores in found.items()}
        methods = {method: pooled_summary([each]) for method, each in own.items()}
        for method, detrend in (("paper", False), (CORRECTED, True)):
            methods[method] = paper_errors(scene, i, changes, rows, detrend)
        flags = {
            f for reading in read["ours"] if reading.sensor == sensor.name for f in reading.flags
        }
        sensors.append(
            {
                "sensor": sensor.name,
                "model": sensor.model,
                "truth_model": scene.simulation.tags[i].truth_model,
                "methods": methods,
                "missed": own["ours"].missed,
                "false": own["ours"].false,
                "flagged": own["ours"].flagged,
                "not_readable": why_not_readable(scene, i),
                "flags": sorted(flags),
                "bound_rms_deg": float(np.sqrt(np.mean(np.square(expected[i].phase_std_deg)))),
                "radio_noise": scene.simulation.radio_noise is not None,
                "expected": {
                    "phase_deg": expected[i].phase_error_deg,
                    "force_n": expected[i].force_error_n,
                    "location_mm": expected[i].location_error_mm,
                },
            }
        )
    return sensors, read["ours"]


def _causes(scene_name, scene, own, work_folder):
    """Errors by cause; empty where the scene explains no published figure."""
    found = {}
    for cause, change in other_causes(scene_name).items():
        disturbed = with_cause(scene, change)
        with simulated(disturbed, work_folder) as captured:
            found[cause] = _errors(_read(disturbed, *captured)[0][0])
    return {OWN: _errors(own), **found} if found else {}


def _errors(sensor):
    kept = ("phase_rms_deg", "force_n", "location_mm")
    errors = {
        name: {key: sensor["methods"][method].get(key) for key in kept}
        for name, method in (("ours", "ours"), ("paper", CORRECTED))
    }
    read = sensor["methods"]["ours"].get("read", 0)
    return {**errors, "flagged": sensor["flagged"], "read": read}


def with_mean_phases(scene, truth):
    """Truth rows with the phases of the mean reflection of each group, not of its centre."""
    tags = AirChannel(scene).sensors
    truth = [row for row in truth if row["sensor"] in tags]
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
