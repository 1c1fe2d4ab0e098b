# SPDX-License-Identifier: GPL-3.0-or-later
"""Channels of scenes in which nothing happens but what a test states."""

from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.channel import AirChannel

QUIET = {"static_clutter_db": None, "snr_db": 120, "duration_s": 20}


def scene(sensors=({},), environment=None, **simulation):
    """A scene of untouched sensors ``s0`` and so on, without anything else unless stated."""
    return load_scene(
        {
            "sensors": [
                {"name": f"s{i}", "model": "line-900mhz"} | sensor
                for i, sensor in enumerate(sensors)
            ],
            "environment": environment or {},
            "simulation": QUIET | simulation,
        }
    )


def channel_of(tag_on=True, **stated):
    """The channel of a scene with one sensor."""
    channel = AirChannel(scene(**stated))
    channel.sensors["s0"].on = tag_on
    return channel
