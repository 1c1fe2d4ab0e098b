#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Prints docs/data/line_dependence.csv: errors of scenes when `line-*` moves otherwise with force.

build/run python3 docs/make_line_dependence.py

Each scene is planned, not simulated, with the line of its carrier under another law, and a reader
that is calibrated with that line as the shipped one is.
"""

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import measure_vna
from gnuradio.wiforce.planning.expected import expect
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene, shipped_scenes
from gnuradio.wiforce.sensor import load_sensor, write_sensor

# Published movement of the near and the far edge of the short at 20 mm and 900 MHz, and of both at
# 40 mm, from 2 to 7.65 N (vna.csv): 8.0, -0.8 to 0.2 and 3.0 mm; 4.4 mm at 40 mm and 2.4 GHz.
LAWS = {
    "shipped": {},
    "ends as published": {"decay_length_mm": 5.35, "asymmetry": 0.99},
    "middle as at 2.4 GHz": {"decay_length_mm": 6.1},
    "half the movement": {"decay_length_mm": 2.0},
}
LOCATIONS_MM = (20, 30, 40, 50, 60)
FORCES_N = np.arange(0.5, 8.1, 0.25)


def moved_mm(line, change, location_mm):
    """How far the edges of the short move from 2 to 7.65 N under a changed law; shape (2,)."""
    contact, sizes = replace(line.contact, **change), (line.length_mm, line.onset_force_n)
    low, high = contact.shorting_points_mm([2.0, 7.65], location_mm, *sizes)
    return low - high


def sensors_of(mhz, change, folder):
    """Paths of a line with another law, and of its calibration."""
    line = load_sensor(f"line-{mhz}mhz")
    line = replace(line, name="pressed", contact=replace(line.contact, **change))
    table = measure_vna(line, LOCATIONS_MM, FORCES_N, noise_deg=0.2, seed=mhz)
    paths = {f"line-{mhz}mhz": line, f"line-{mhz}mhz-calibrated": calibrate(table, "reader")}
    for name, sensor in paths.items():
        write_sensor(sensor, folder / f"{name}.yaml")
    return {name: str(folder / f"{name}.yaml") for name in paths}


def expected_with(name, sensors):
    """Expected errors of a scene's sensors, with its models replaced."""
    content = load_scene(name).as_dict()
    for sensor in content["sensors"]:
        sensor["model"] = sensors[sensor["model"]]
    simulation = content["simulation"]
    for tag in [simulation, *simulation["tags"]]:
        tag["truth_model"] = sensors.get(tag["truth_model"], tag["truth_model"])
    return expect(plan(load_scene(content)))


def main():
    shipped = {path.stem for path in (Path(DATA_DIR) / "sensors").glob("line-*.yaml")}
    print("scene,sensor,law,near_20mm_moves_mm,far_20mm_moves_mm,middle_moves_mm,", end="")
    print("phase_error_deg,force_error_n,location_error_mm")
    for name in shipped_scenes():
        scene = load_scene(name)
        models = {sensor.model for sensor in scene.sensors}
        truths = {tag.truth_model for tag in scene.simulation.tags}
        if scene.surface is not None or not models | truths <= shipped:
            continue
        mhz = round(scene.radio.center_frequency_hz / 1e6)
        for law, change in LAWS.items():
            with tempfile.TemporaryDirectory() as folder:
                sensors = sensors_of(mhz, change, Path(folder))
                found = expected_with(name, sensors)
            line = load_sensor(f"line-{mhz}mhz")
            near, far = moved_mm(line, change, 20.0)
            moves = f"{near:.1f},{far:.1f},{moved_mm(line, change, 40.0)[0]:.1f}"
            for sensor in found:
                if sensor.phase_error_deg is not None:
                    phase = np.mean(sensor.phase_error_deg)
                    errors = (
                        f"{phase:.3g},{sensor.force_error_n:.3g},{sensor.location_error_mm:.3g}"
                    )
                    print(f"{name},{sensor.sensor},{law},{moves},{errors}", flush=True)


if __name__ == "__main__":
    main()
