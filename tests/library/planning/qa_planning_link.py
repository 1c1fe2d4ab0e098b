# SPDX-License-Identifier: GPL-3.0-or-later
"""What a plan says of a link budget, and of noise that a radio adds to its static path."""

import json
from dataclasses import replace

import numpy as np
import pytest
from command_runs import run_command
from gnuradio.wiforce.io.readings import WEAK_PHASE_DEG
from gnuradio.wiforce.planning.advice import warnings
from gnuradio.wiforce.planning.expected import phase_std_deg, receive_levels, why_not_readable
from gnuradio.wiforce.planning.link import carrier_reaches, link_lines
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene

SENSORS = [{"name": "arm", "model": "line-900mhz-calibrated"}]
AIR = {"transmitter_m": 5, "receiver_m": 5, "antennas_m": 1}


def plan_with(**simulation):
    return plan(load_scene({"sensors": SENSORS, "simulation": simulation}))


def test_a_scene_without_a_link_names_no_carriers():
    assert carrier_reaches(plan_with()) == []
    assert list(link_lines(plan_with(), [])) == []


def test_own_carrier_has_the_noise_that_the_plan_expects():
    settings = plan_with(link=AIR | {"direct_loss_db": 25}, radio_noise={})
    own, *others = carrier_reaches(settings)
    simulation = settings.scene.simulation
    assert (own.snr_db, own.static_db) == pytest.approx(
        (simulation.snr_db, simulation.static_clutter_db), abs=0.006
    )
    assert own.phase_std_deg == pytest.approx(phase_std_deg(settings).max(), rel=2e-3)
    assert [round(each.carrier_hz / 1e6, 2) for each in others] == [915, 2441.75, 5787.5, 5800]


def test_5_m_in_air_are_read_at_900_mhz_and_where_readings_become_weak_is_found():
    """10 dBm and a direct path of 1 m: the plan at the distance found has 3 degrees."""
    own, *_ = carrier_reaches(plan_with(link=AIR))
    assert own.phase_std_deg < 0.1 and own.reach > 5
    far = AIR | {"transmitter_m": own.reach, "receiver_m": own.reach}
    assert phase_std_deg(plan_with(link=far)).max() == pytest.approx(WEAK_PHASE_DEG, rel=0.01)


def test_tissue_reads_deepest_at_the_lower_carrier():
    settings = plan(load_scene("phantom"))
    reaches = carrier_reaches(settings)
    by_mhz = {round(each.carrier_hz / 1e6): each.reach for each in reaches}
    # Muscle loses a factor e of amplitude, there and back, in 21 mm at 900 MHz, in 11 at 2.4 GHz.
    assert 50 < by_mhz[900] < 90 and by_mhz[2442] < by_mhz[900] / 5
    *_, last = link_lines(settings, reaches)
    assert last == f"deepest: 900 MHz, {by_mhz[900]:.2g} mm of muscle"


def test_a_tag_out_of_the_range_of_the_adc_is_read_at_no_such_distance():
    """The carrier had 0.25 degrees and read up to 17 m, beside 'not readable' at 5 m."""
    strong = {"transmit_dbm": 50, "transmitter_dbi": 20, "receiver_dbi": 20, "noise_figure_db": 0}
    link = {"transmitter_m": 5, "receiver_m": 5, "antennas_m": 1} | strong
    settings = plan_with(link=link)
    own, *_ = reaches = carrier_reaches(settings)
    assert "out of the ADC's range" in why_not_readable(settings.scene, 0)
    assert own.reach < 5
    assert "unknown" in list(link_lines(settings, reaches))[2]
    nearer = link | {"transmitter_m": 0.95 * own.reach, "receiver_m": 0.95 * own.reach}
    assert why_not_readable(plan_with(link=nearer).scene, 0) is None


def test_command_prints_the_carriers_as_text_and_json():
    text = run_command("plan", "phantom").stdout
    found = json.loads(run_command("plan", "phantom", "--json").stdout)["link"]
    assert "link: 110.1 dB by way of the tag, 60.0 dB straight" in text.splitlines()
    assert found[0]["band"] == "" and found[1]["band"] == "us-902-928"
    assert f"deepest: 900 MHz, {found[0]['reach']:.2g} mm of muscle" in text.splitlines()
    assert "deepest: none reads clearly" in run_command("plan", "phantom_no_plate").stdout
    assert "link" not in json.loads(run_command("plan", "demo", "--json").stdout)


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
