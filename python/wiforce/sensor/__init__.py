# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensors: models, calibration, inversion, the physical line. Numpy only."""

from .file import load_sensor, sensor_from_dict, sensor_to_dict, shipped_sensors, write_sensor
from .model import LineModel, SensorModel, wrap_deg

__all__ = [
    "LineModel",
    "SensorModel",
    "load_sensor",
    "sensor_from_dict",
    "sensor_to_dict",
    "shipped_sensors",
    "wrap_deg",
    "write_sensor",
]
