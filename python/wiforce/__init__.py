# SPDX-License-Identifier: GPL-3.0-or-later
"""GNU Radio blocks that read contact force and its location from a passive wireless sensor.

Blocks are imported when they are first named, so that the numpy rooms (``estimation``,
``sensor``, ``scene``) can be used where GNU Radio's runtime is not wanted.
"""

import importlib

_BLOCKS = {
    # C++ blocks
    "preamble_fold": "wiforce_python",
    "ofdm_channel_estimator": "wiforce_python",
    "phase_group_doppler": "wiforce_python",
    "recording_source": "wiforce_python",
    # Python blocks
    "sounding_source": "sounding_source",
    "end_separation": "end_separation",
    "tone_weights": "end_separation",
    "tone_derotation": "end_separation",
    "conjugate_difference": "conjugate_difference",
    "subcarrier_average": "subcarrier_average",
    "force_inversion": "force_inversion",
    "reader": "reader",
    "backscatter_tag": "backscatter_tag",
}

__all__ = list(_BLOCKS)


def __getattr__(name):
    if name not in _BLOCKS:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    module = importlib.import_module(f".{_BLOCKS[name]}", __name__)
    return getattr(module, name)


def __dir__():
    return sorted([*globals(), *_BLOCKS])
