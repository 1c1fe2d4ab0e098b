# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated files of a card that receives a tag, and their readings."""

import warnings

import numpy as np
import pandas as pd
from gnuradio import wiforce
from packet_simulator import PacketCapture, PacketTag

PERIOD_S = 0.25
FORCE_N, LOCATION_MM = 4, 35


def scene_of(clocks_hz=(134,)):
    """A scene of tags ``tag0`` and so on: 225 packets in a quarter of a second."""
    return {
        "packets": {"interval_s": PERIOD_S / 225},
        "radio": {"center_frequency_hz": 2.44e9},
        "phase_group": {"snapshots": 225},
        "reference_s": 1.5,
        "sensors": [
            {"name": f"tag{i}", "model": "line-2440mhz", "clock_hz": hertz}
            for i, hertz in enumerate(clocks_hz)
        ],
    }


def capture_of(line_db, snr_db=30.0, **more):
    """4 N at 35 mm on a tag whose first line is some dB below the direct path."""
    static = 0.225 * 10 ** (line_db / 20)
    settings = {"seed": 5, "subcarriers": 16, "duration_s": 4.5, "touched_s": (2.0, 4.5)}
    settings["gain_db"] = (0.0, 0.5)
    noise = static * 10 ** (-snr_db / 20)
    return PacketCapture([PacketTag(134.0)], static=static, noise=noise, **(settings | more))


def quietly_read(path, scene):
    """Readings of a file, whose warnings are not looked at."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return wiforce.read(path, scene)


def readings_of(capture, folder, scene=None, first_s=2.25, last_s=None):
    """Readings of steady touches, clear ones, and their errors over standard deviations."""
    capture.save(folder / "p.npz")
    readings = quietly_read(folder / "p.npz", scene or scene_of())
    last_s = last_s or capture.touched_s[1] - PERIOD_S
    steady = readings[(readings["time_s"] > first_s) & (readings["time_s"] < last_s)]
    clear = steady[steady["flags"] == ""]
    stds = (clear["force_n"] - FORCE_N).abs() / clear["force_std_n"]
    return steady, clear, stds.to_numpy()


def readings_of_rooms(line_db, seeds, folder, **effects):
    """Steady and clear readings in several rooms, and errors over standard deviations."""
    rooms = [readings_of(capture_of(line_db, seed=seed, **effects), folder) for seed in seeds]
    steady, clear, stds = zip(*rooms, strict=True)
    return pd.concat(steady), pd.concat(clear), np.concatenate(stds)
