# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings beside the phase noise of two synthesizers, which the static path carries."""

import numpy as np
import pandas
from gnuradio import wiforce

SCENE = {
    "radio": {"sample_rate_hz": 2.5e6},
    "sounding": {"frame_length": 360},
    "phase_group": {"snapshots": 250},
    "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": 670}],
    "simulation": {
        "truth_model": "line-900mhz",
        "duration_s": 1.6,
        "seed": 2,
        "static_clutter_db": 55,
        "radio_noise": {},
        "presses": [
            {"start_s": 0.7, "hold_s": 0.6, "force_n": 2.0, "end_force_n": 5.0, "location_mm": 35}
        ],
    },
}


def read(folder, **simulation):
    scene = SCENE | {"simulation": SCENE["simulation"] | simulation}
    wiforce.simulate(scene, folder / "press", overwrite=True)
    readings = wiforce.read(folder / "press")
    truth = pandas.read_csv(folder / "press.truth.csv").iloc[: len(readings)]
    both = (readings.touch.to_numpy() == 1) & (truth.touch.to_numpy() == 1)
    error = (readings.force_n - truth.force_n).to_numpy()[both]
    return error, readings.force_std_n.to_numpy()[both], readings.ok.to_numpy()[both]


def test_readings_beside_phase_noise_state_their_errors(tmp_path):
    """Several times the error of the receiver's own noise, and no reading that hides it."""
    error, std, ok = read(tmp_path)
    quiet_error, quiet_std, quiet_ok = read(tmp_path, radio_noise={"synthesizers": "one"})
    assert len(error) >= 16 and np.mean(quiet_ok) > 0.7
    assert np.median(std) > 3 * np.median(quiet_std)
    assert np.median(np.abs(error)) > 2 * np.median(np.abs(quiet_error))
    wrong = ok & (np.abs(error) > 5 * std) & (np.abs(error) > 0.3)
    assert not wrong.any() and np.mean(np.abs(error) <= 2 * std) > 0.9
