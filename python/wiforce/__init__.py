# SPDX-License-Identifier: GPL-3.0-or-later
"""GNU Radio blocks that read contact force and its location from a passive wireless sensor.

Names are imported when they are first used: only the blocks load GNU Radio's runtime.
"""

import importlib
import importlib.util
from typing import Any

from .errors import gnuradio_rule

_BLOCKS_IN_CPP = (
    "ofdm_channel_estimator",
    "phase_group_doppler",
    "preamble_fold",
    "recording_source",
)
_BLOCKS_IN_PYTHON = {
    "chain": (
        "clock_offset",
        "conjugate_difference",
        "end_separation",
        "force_inversion",
        "readings_to_floats",
        "subcarrier_average",
    ),
    "displays": ("doppler_display", "force_display", "phase_display", "trend_display"),
    "frame_alignment": ("frame_alignment",),
    "reader": ("reader",),
    "sample_files": ("capture_source", "sigmf_recorder"),
    "snapshots": ("antenna_ratio",),
    "sounding": ("backscatter_tag", "sounding_source"),
    "usrp": ("usrp",),
}
_MODULES = {
    **dict.fromkeys(_BLOCKS_IN_CPP, "wiforce_python"),
    **{name: f"blocks.{module}" for module, names in _BLOCKS_IN_PYTHON.items() for name in names},
    "ForceDisplay": "gui",
    "Groups": "estimation.groups",
    "Receiver": "receiver.receiver",
    "load_scene": "scene",
    "load_sensor": "sensor",
    "open_writer": "io.files.writers",
    "plan": "planning.plan",
    "plot": "receiver.plotting",
    "plan_for_capture": "receiver.captures",
    "read": "receiver.captures",
    "score": "calibration.gauge_comparison",
    "simulate": "receiver.captures",
    "calibrate": "calibration.calibrate",
    "survey": "receiver.captures",
    "phase_bound_deg": "signal.bound",
    "sounding_waveform": "signal.waveform",
}
# What the blocks' parameters in Companion are made with, and checked by.
_FOR_COMPANION = (
    "is_amplitude_of",
    "is_capture",
    "is_carrier_of",
    "is_scene",
    "is_waveform",
    "scene_in_companion",
    "symbol_length_of",
)

# What folders need besides the packages that are always there.
_NEEDED_BY = {"blocks": "pmt", "wiforce_python": "pmt", "gui": "PyQt5"}


def __getattr__(name: str) -> Any:
    if name == "__all__":
        return _usable()
    module = "blocks.rules" if name in _FOR_COMPANION else _MODULES.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(importlib.import_module(f".{module}", __name__), name)
    except ImportError as error:
        rule = gnuradio_rule(error)
        if rule is None:
            raise
        raise ImportError(f"{name} {rule}", name=error.name) from error


def __dir__() -> list[str]:
    return sorted(_usable())


def _usable() -> list[str]:
    """Public names that can be imported, so that `help` and editors can look at all of them."""
    needed = {name: _NEEDED_BY.get(path.partition(".")[0]) for name, path in _MODULES.items()}
    absent = {each for each in needed.values() if each and importlib.util.find_spec(each) is None}
    return [name for name, each in needed.items() if each not in absent]
