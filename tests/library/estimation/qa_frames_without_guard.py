# SPDX-License-Identifier: GPL-3.0-or-later
"""Symbols that follow each other without a guard, and clocks whose lines alias."""

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.capture.frame import find_frame_period
from gnuradio.wiforce.signal.waveform import sounding_waveform

RATE_HZ = 1.25e6


def symbol_file(folder, length, seed):
    """A random symbol of unit power."""
    symbol = np.random.default_rng(seed).standard_normal((length, 2)) @ np.array([1, 1j])
    path = folder / f"symbol{length}_{seed}.npy"
    np.save(path, (symbol / np.sqrt(np.mean(np.abs(symbol) ** 2))).astype(np.complex64))
    return path


def scene_of(symbol, length, clock_hz=1040.0):
    press = {"start_s": 0.4, "hold_s": 0.25, "force_n": 4.0, "end_force_n": 4.0}
    return {
        "radio": {"center_frequency_hz": 900e6, "sample_rate_hz": RATE_HZ},
        "sounding": {"waveform": str(symbol), "repetitions": 5, "frame_length": 5 * length},
        "phase_group": {"snapshots": round(0.036 * RATE_HZ / (5 * length))},
        "sensors": [{"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": clock_hz}],
        "reference_s": 0.3,
        "simulation": {
            "truth_model": "line-900mhz",
            "duration_s": 0.8,
            "static_clutter_db": 50,
            "presses": [{"sensor": "arm", "location_mm": 37.0, **press}],
        },
    }


@pytest.mark.parametrize("length", [17, 19, 23])
@pytest.mark.parametrize("seed", [1, 3])
def test_frames_without_a_guard_are_read(length, seed, tmp_path):
    """Half of the captures were refused, as if they held no frames."""
    scene = scene_of(symbol_file(tmp_path, length, seed), length)
    wiforce.simulate(scene, tmp_path / "press")
    readings = wiforce.read(tmp_path / "press", scene)
    held = readings[(readings["time_s"] > 0.52) & (readings["time_s"] < 0.64) & readings["ok"]]
    assert len(held) >= 2
    assert np.abs(held["force_n"] - 4).max() < 0.4


@pytest.mark.parametrize("length", [17, 23, 64])
def test_other_symbols_and_noise_of_the_same_period_are_no_frames(length, tmp_path):
    """Everything that repeats as often has the same period."""
    sent, expected = (
        sounding_waveform(str(symbol_file(tmp_path, length, seed)), 5 * length, repetitions=5)
        for seed in (1, 2)
    )
    noise = np.random.default_rng(1).standard_normal((65_000, 2)) @ np.array([1, 1j])
    received = np.tile(sent.frame(), 65_000 // (5 * length))
    received = received + 0.03 * noise[: len(received)]
    assert find_frame_period(received, sent).agrees
    assert not find_frame_period(received, expected).agrees
    assert not find_frame_period(noise, expected).agrees


@pytest.mark.parametrize("parts", [9, 10, 12])
def test_clock_whose_lines_alias_is_refused_by_simulate_as_by_read(parts, tmp_path):
    """It was simulated, and then refused with words about another tag."""
    scene = scene_of("repeated", 64, RATE_HZ / 320 / parts)
    del scene["sounding"]["repetitions"]
    with pytest.raises(InputError, match=r"sensors\[0\].clock_hz: must leave the tag") as refusal:
        wiforce.simulate(scene, tmp_path / "press")
    assert "another tag" not in str(refusal.value) and not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"sensors\[0\].clock_hz: must leave the tag"):
        wiforce.plan(scene)
