# SPDX-License-Identifier: GPL-3.0-or-later
"""The check of a device before a measurement."""

import json

import numpy as np
import pytest
from command_runs import succeeded
from gnuradio.wiforce.blocks.usrp import first_gain_db
from gnuradio.wiforce.planning.findings import MeasuredTag
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.channel import AirChannel
from live_runs import FRAMES, GAINS
from wiforce_app.plan.check import Findings, advice_on


def test_check_measures_levels_delay_and_clock(slow_scene, slow_device):
    check = ["check", "--scene", slow_scene, "--args", f"{slow_device.args},{FRAMES}", "--json"]
    done = succeeded(*check, *GAINS)
    assert not done.stderr
    found = json.loads(done.stdout)
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


ARM = [MeasuredTag("arm", 1.0)]


@pytest.mark.parametrize(
    ("peak_dbfs", "clipped", "found", "words"),
    [
        (-60.0, 0.0, {}, "raise --tx-gain, then --rx-gain"),
        # Steps of 6 dB took seven runs; the offset of clipped samples is not the device's.
        (0.0, 1e-4, {}, "lower --rx-gain, then --tx-gain, by 6 dB in total"),
        (0.0, 0.45, {}, "lower --rx-gain, then --tx-gain, by 17 dB in total"),
        (0.0, 1.0, {}, "lower --rx-gain, then --tx-gain, by 36 dB or more in total"),
        (-6.0, 0.0, {"frames_moved": 2, "sensors": ARM}, "frame timing shifted 2 times"),
        (-6.0, 0.0, {"sensors": [MeasuredTag("arm")]}, "none is within clock_tolerance_ppm (100)"),
    ],
)
def test_check_advises_on_level_timing_and_tag(peak_dbfs, clipped, found, words):
    levels = {"peak_dbfs": peak_dbfs, "clipped": clipped, "dc_dbfs": -3.0 if clipped else -90.0}
    (advice,) = advice_on(Findings("a device", {}, levels, **found), load_scene("demo"))
    assert words in advice


def test_first_gains_of_a_b210_are_those_of_the_page():
    assert [first_gain_db(0.0, high) for high in (89.75, 76.0)] == pytest.approx([30, 25], abs=0.5)
