# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models, their calibration and inversion."""

from .calibration import calibrate
from .calibration_session import CalibrationSession
from .calibration_warnings import calibration_warnings
from .file import load_sensor, sensor_from_dict, sensor_to_dict, shipped_sensors, write_sensor
from .force_gauge import ForceGauge, parse_force
from .inversion import Inversion
from .line_estimate import estimate_line
from .model import LineModel, SensorModel
from .phase_plausibility import phase_suspicions
from .plausibility import suspicions
from .press_measurement import PressMeasurement, measure_press, measure_untouched
from .refine import refine
from .session_plan import SessionPlan
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
from .verdict import verdict

__all__ = [
    "CalibrationSession",
    "CalibrationTable",
    "ForceGauge",
    "Inversion",
    "LineModel",
    "PressMeasurement",
    "PressTracker",
    "SensorModel",
    "SessionPlan",
    "calibrate",
    "calibration_warnings",
    "estimate_line",
    "load_sensor",
    "measure_press",
    "measure_untouched",
    "measure_vna",
    "parse_force",
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
    "verdict",
    "write_sensor",
    "write_vna_csv",
]
