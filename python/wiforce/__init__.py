# SPDX-License-Identifier: GPL-3.0-or-later
"""GNU Radio blocks that read contact force and its location from a passive wireless sensor.

Blocks are imported when they are first named, so that the numpy rooms (``estimation``,
``sensor``, ``scene``) can be used where GNU Radio's runtime is not wanted.
"""

import importlib
import sys
import types

_HOMES = {
    # C++ blocks
    "preamble_fold": "wiforce_python",
    "ofdm_channel_estimator": "wiforce_python",
    "phase_group_doppler": "wiforce_python",
    "recording_source": "wiforce_python",
    # Python blocks
    "sounding_source": "sounding_source",
    "antenna_ratio": "antenna_ratio",
    "end_separation": "end_separation",
    "conjugate_difference": "conjugate_difference",
    "subcarrier_average": "subcarrier_average",
    "force_inversion": "force_inversion",
    "reader": "reader",
    "capture_source": "capture_source",
    "clock_offset": "clock_offset",
    "frame_alignment": "frame_alignment",
    "sigmf_recorder": "sigmf_recorder",
    "backscatter_tag": "backscatter_tag",
    "force_display": "force_display",
    "trend_display": "trend_display",
    "ForceDisplay": "display",
    # what their parameters are made with, and checked by
    "tone_weights": "tones",
    "tone_derotation": "tones",
    "tone_count": "tones",
    "load_scene": "scene",
    "load_sensor": "sensor",
    "open_writer": "readings",
    "is_scene": "rules",
    "is_capture": "rules",
    "is_sensor": "rules",
    "is_carrier_of": "rules",
    "is_amplitude_of": "rules",
    "is_tone_design": "rules",
}

__all__ = list(_HOMES)


def __getattr__(name):
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f".{_HOMES[name]}", __name__)
    return getattr(module, name)


class _Package(types.ModuleType):
    """Lets the name of a block mean the block, not the file of that name it lives in."""

    def __setattr__(self, name, value):
        # What the import system does to a package when one of its files has been loaded.
        if _HOMES.get(name) == name and isinstance(value, types.ModuleType):
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __dir__():
    return sorted([*globals(), *_HOMES])
