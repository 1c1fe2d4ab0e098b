# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models, their calibration and inversion."""

from .calibration import calibrate
from .calibration_warnings import calibration_warnings
from .file import load_sensor, sensor_from_dict, sensor_to_dict, shipped_sensors, write_sensor
from .inversion import Inversion
from .model import LineModel, SensorModel
from .plausibility import estimate_line, phase_suspicions, suspicions
from .refine import refine
from .simulated_vna import measure_vna
from .smoother import smooth_press
from .tables import (
    CalibrationTable,
    read_tap_csv,
    read_touchstone_index,
    read_vna_csv,
    table_kind,
    write_vna_csv,
)
from .touch_test import touch_of
from .tracker import PressTracker

__all__ = [
    "CalibrationTable",
    "Inversion",
    "LineModel",
    "PressTracker",
    "SensorModel",
    "calibrate",
    "calibration_warnings",
    "estimate_line",
    "load_sensor",
    "measure_vna",
    "phase_suspicions",
    "read_tap_csv",
    "read_touchstone_index",
    "read_vna_csv",
    "refine",
    "sensor_from_dict",
    "sensor_to_dict",
    "shipped_sensors",
    "smooth_press",
    "suspicions",
    "table_kind",
    "touch_of",
    "write_sensor",
    "write_vna_csv",
]
