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
    "calibrate": ("calibrate", "refine"),
    "mistakes": ("suspicions", "untouched_assumed"),
    "session": ("CalibrationSession", "SessionPlan", "measure_press"),
    "tables": (
        *("CalibrationTable", "measure_vna", "table_kind", "write_vna_csv"),
        *("read_tap_csv", "read_touchstone_index", "read_vna_csv"),
    ),
    "validation": ("calibration_warnings", "verdict"),
}
_MODULES = {name: module for module, names in _ELSEWHERE.items() for name in names}

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
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"..calibration.{_MODULES[name]}", __name__), name)
