# SPDX-License-Identifier: GPL-3.0-or-later
"""What a plan says of noise that a radio adds to its static path."""

from dataclasses import replace

import numpy as np
import pytest
from gnuradio.wiforce.planning.advice import warnings
from gnuradio.wiforce.planning.expected import phase_std_deg, receive_levels
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene

SENSORS = [{"name": "arm", "model": "line-900mhz-calibrated"}]


def plan_with(**simulation):
    return plan(load_scene({"sensors": SENSORS, "simulation": simulation}))


def test_noise_of_two_synthesizers_beside_a_static_path_is_expected():
    """By hand: -101 dBc/Hz at 60 dB, aliased from a loop of 30 kHz, q = 0.155, 36 ms."""
    settings = plan_with(snr_db=60, static_clutter_db=60, adc_bits=None, radio_noise={})
    hertz = 1000 + np.arange(-30, 31) * 12.5e6 / 720
    density = 10**-10.1 * np.sum(np.sinc(hertz * 20.48e-6) ** 2 / (1 + (hertz / 30e3) ** 2))
    line = 0.25 * np.sinc(0.25) * np.sinc(0.02048)
    variance = line**2 * 1e6 * density / (2 * 0.155 * 0.036) * (1 + 1 / 13)
    assert phase_std_deg(settings).mean() == pytest.approx(np.degrees(np.sqrt(variance)), rel=0.03)
    assert any("dynamic range" in text for text in warnings(settings))


@pytest.mark.parametrize(
    "change",
    [
        {"radio_noise": None},
        {"radio_noise": {"synthesizers": "one", "transmitter_dbc_hz": -200}},
        {"radio_noise": {}, "static_clutter_db": None},
    ],
)
def test_radios_that_add_no_noise_cost_nothing(change):
    settings = plan_with(**change)
    assert receive_levels(settings.scene).radio < 1e-6 * receive_levels(settings.scene).noise
    assert not any("dynamic range" in text for text in warnings(settings))


def test_two_antennas_share_phase_noise_but_not_the_transmitters():
    scene = load_scene({"sensors": SENSORS, "simulation": {"radio_noise": {}}})
    free = replace(scene.environment, reader_clock="free", receive_antennas=2)
    one, two = (receive_levels(s).radio for s in (scene, replace(scene, environment=free)))
    line = 0.25 * np.sinc(0.25) * np.sinc(0.02048)
    sent = line**2 * 1e6 * 10**-14.5 * 12.5e6 * 62 / 256
    assert two == pytest.approx(sent, rel=1e-6) and one > 100 * two
