# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models: phases from force and location, the inverse, and their files.

`model` is what every sensor can do, `line` the physics of a pressed line, `curves` calibrated
curves and `location` what lies between their locations. `inversion` gives force and location of
phases by a tabulated model, and `tracker` follows a press over time.
"""

from importlib import import_module
from typing import Any

from .file import load_sensor, sensor_from_dict, sensor_to_dict, shipped_sensors, write_sensor
from .inversion import Inversion
from .model import LineModel, SensorModel, touch_of
from .tracker import PressTracker

# Where `calibration` has the names that programs import from here.
_ELSEWHERE = {
    "CalibrationSession": "calibration.session",
    "CalibrationTable": "calibration.tables",
    "SessionPlan": "calibration.session",
    "calibrate": "calibration.calibrate",
    "calibration_warnings": "calibration.validation",
    "measure_press": "calibration.session",
    "measure_vna": "calibration.tables",
    "read_tap_csv": "calibration.tables",
    "read_touchstone_index": "calibration.tables",
    "read_vna_csv": "calibration.tables",
    "refine": "calibration.calibrate",
    "suspicions": "calibration.mistakes",
    "table_kind": "calibration.tables",
    "untouched_assumed": "calibration.mistakes",
    "verdict": "calibration.validation",
    "write_vna_csv": "calibration.tables",
}

__all__ = [
    "Inversion",
    "LineModel",
    "PressTracker",
    "SensorModel",
    "load_sensor",
    "sensor_from_dict",
    "sensor_to_dict",
    "shipped_sensors",
    "touch_of",
    "write_sensor",
]


def __getattr__(name: str) -> Any:
    """Import a name of the calibration on first use: models do not need it."""
    if name not in _ELSEWHERE:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__.rpartition('.')[0]}.{_ELSEWHERE[name]}"), name)
