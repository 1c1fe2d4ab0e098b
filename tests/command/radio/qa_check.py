# SPDX-License-Identifier: GPL-3.0-or-later
"""The check of a device before a measurement."""

import json

import numpy as np
import pytest
from gnuradio.wiforce.blocks.usrp import first_gain_db
from gnuradio.wiforce.planning.findings import Finding, MeasuredTag
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.channel import AirChannel
from live_runs import FRAMES, GAINS, command
from wiforce_app.plan.check import Findings, advice_on


def test_check_measures_levels_delay_and_clock(slow_scene, slow_device):
    check = ["check", "--scene", slow_scene, "--args", f"{slow_device.args},{FRAMES}", "--json"]
    status, out, said = command(*check, *GAINS)
    assert (status, said) == (0, ""), said
    found = json.loads(out)
    # A scene on the air: peak 3 dB below full scale, noise by snr_db, 5.12 us of delay.
    channel = AirChannel(load_scene(slow_scene))
    assert found["levels"]["peak_dbfs"] == pytest.approx(-3, abs=1)
    noise_dbfs = 20 * np.log10(channel.noise_std)
    assert found["levels"]["noise_dbfs"] == pytest.approx(noise_dbfs, abs=0.3)
    assert found["levels"]["dc_dbfs"] < -90 and found["levels"]["clipped"] == 0
    assert found["delay_us"] == pytest.approx(5.12 + 2 * 0.4, abs=0.5)
    (arm,) = found["sensors"]
    assert arm["clock_offset_ppm"] == pytest.approx(40, abs=4)
    assert arm["snr_db"] == pytest.approx([10, 10], abs=1)
    assert max(arm["phase_error_deg"]) < 0.3
    assert found["advice"] == []
    assert found["room"] == []  # a quiet one


def test_check_of_a_level_far_too_low_asks_for_more():
    levels = {"peak_dbfs": -60.0, "clipped": 0.0, "dc_dbfs": -90.0}
    (advice,) = advice_on(Findings("a device", {}, levels), load_scene("demo"))
    assert "raise --tx-gain, then --rx-gain" in advice


def test_check_timing_shift_is_part_of_advice(slow_scene):
    levels = {"peak_dbfs": -6.0, "clipped": 0.0, "dc_dbfs": -90.0}
    findings = Findings("a device", {}, levels, frames_moved=2, sensors=[MeasuredTag("arm", 1.0)])
    (advice,) = advice_on(findings, load_scene(slow_scene))
    assert "frame timing shifted 2 times" in advice


def test_check_without_a_tag_at_its_clock_names_the_one_on_the_air(slow_scene):
    levels = {"peak_dbfs": -6.0, "clipped": 0.0, "dc_dbfs": -90.0}
    room = [Finding("tag", 400.016, 0.0, "a tag", "solved for", True)]
    findings = Findings("a device", {}, levels, sensors=[MeasuredTag("arm")], room=room)
    (advice,) = advice_on(findings, load_scene(slow_scene))
    assert ": on the air is a clock of 400.016 Hz, which the scene does not list" in advice
    findings = Findings("a device", {}, levels, sensors=[MeasuredTag("arm")], room=[])
    (advice,) = advice_on(findings, load_scene(slow_scene))
    assert "no tag detected at 400 Hz: none is within clock_tolerance_ppm (100) of it" in advice


@pytest.mark.parametrize("clipped, step", [(1e-4, "6 dB"), (0.45, "17 dB"), (1.0, "36 dB or more")])
def test_check_clipped_samples_ask_for_a_step_that_ends_it(clipped, step):
    """Steps of 6 dB took seven runs; the offset of clipped samples is not the device's."""
    levels = {"peak_dbfs": 0.0, "clipped": clipped, "dc_dbfs": -3.0}
    (advice,) = advice_on(Findings("a device", {}, levels), load_scene("demo"))
    assert f"lower --rx-gain, then --tx-gain, by {step} in total" in advice


def test_first_gains_of_a_b210_are_those_of_the_page():
    assert [first_gain_db(0.0, high) for high in (89.75, 76.0)] == pytest.approx([30, 25], abs=0.5)
