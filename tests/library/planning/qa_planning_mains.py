# SPDX-License-Identifier: GPL-3.0-or-later
"""Clocks away from the lines of lamps, and carriers inside the permitted band."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from command_runs import run_command
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.planning.advice import (
    improve,
    licence_note,
    outside_band,
    warnings,
)
from gnuradio.wiforce.planning.clocks import clocks_for, propose_clocks
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.signal.lines import lamp_distances_hz
from plain import make_plan

GROUP = make_plan(())
BOTH = (50.0, 60.0)


def nearest_lamp_hz(clock_hz, mains_hz):
    """Least distance of lines 1, 2 and 4 to a list of a lamp's lines."""
    lamps = np.concatenate([2 * hz * np.arange(200) for hz in mains_hz])
    return min(np.abs(m * clock_hz - lamps).min() for m in (1, 2, 4))


def with_carrier(scene, carrier_hz):
    return replace(scene, radio=replace(scene.radio, center_frequency_hz=carrier_hz))


def scene_of(clock_hz=1000.0, **sections):
    sensor = {"name": "arm", "model": "line-900mhz-calibrated", "clock_hz": clock_hz}
    return load_scene({"sensors": [sensor], **sections})


@pytest.mark.parametrize("mains_hz", [BOTH, (50.0,), (60.0,)])
def test_lamp_distances_equal_search_among_lamp_lines(mains_hz):
    """A wrong distance would recommend clocks that lamps disturb."""
    for clock_hz in (387.0, 1000.0, 1035.0, 1040.0, 1399.5, 2150.0):
        found = lamp_distances_hz(clock_hz, mains_hz).min()
        assert found == pytest.approx(nearest_lamp_hz(clock_hz, mains_hz))


def named_by_improve(scene):
    """Clocks that ``plan --improve`` names, by the index of the sensor."""
    changes = [p.change for p in improve(plan(scene)) if "clock_hz" in p.change]
    named = re.findall(r"sensors\[(\d+)\].clock_hz: ([\d.]+)", ", ".join(changes))
    return {int(index): float(hz) for index, hz in named}


@pytest.mark.parametrize(
    "name, clocks_hz",
    [("workshop_lamps", [1035.0]), ("two_sensors", [1035.0, 1365.0]), ("tabletop", None)],
)
def test_plan_warning_improve_and_proposal_name_the_same_clocks(name, clocks_hz):
    """A tag builder who asks in two ways must not get two answers."""
    scene = load_scene(name)
    proposed = clocks_for(scene, len(scene.sensors)).clocks_hz
    assert clocks_hz is None or proposed == clocks_hz
    texts = [text for text in warnings(plan(scene)) if text.startswith("lamps")]
    warned = {float(text.split("with a clock of ")[1].split()[0]) for text in texts}
    improved = named_by_improve(scene)
    assert warned and warned <= set(proposed)
    for i, hz in enumerate(proposed):
        assert improved.get(i, hz) == hz


def test_clock_that_a_firmware_makes_stays_where_another_gains_little():
    """`design` makes 1033.0579 Hz; 4 Hz farther from lamps are not worth another crystal."""
    scene = scene_of(1033.0579)
    assert clocks_for(scene, 1).clocks_hz == [1033.0579]
    assert named_by_improve(scene) == {}
    assert not any(text.startswith("lamps") for text in warnings(plan(scene)))


def test_improve_of_packets_names_the_proposed_clocks():
    """Packets have times of their own, but a scene with them has one proposal as well."""
    scene = scene_of(120.0, packets={}, phase_group={"snapshots": 300})
    (proposed,) = clocks_for(scene, 1).clocks_hz
    assert named_by_improve(scene) == {0: proposed}


def test_proposed_clock_nearest_to_own_of_those_as_far_from_lamps():
    """Crystal and divider can often stay when the clock changes by little."""
    (near,) = propose_clocks(1, GROUP, near_hz=[1400.0])
    (free,) = propose_clocks(1, GROUP)
    assert near == 1365 and nearest_lamp_hz(near, BOTH) == nearest_lamp_hz(free, BOTH) == 30


def test_plan_names_only_clocks_that_it_accepts():
    """At 3906 snapshots/s the ninth line of 435 Hz meets aliases: a scene with it is refused."""
    scene = scene_of(
        400,
        radio={"sample_rate_hz": 1.25e6},
        sounding={"frame_length": 320},
        phase_group={"snapshots": 125},
    )
    (found,) = [text for text in warnings(plan(scene)) if text.startswith("lamps")]
    named = float(found.split("with a clock of ")[1].split()[0])
    changed = [{"name": "arm", "model": "line-900mhz", "clock_hz": named}]
    plan(scene.as_dict() | {"sensors": changed})
    with pytest.raises(InputError, match="must leave the tag a line"):
        plan(scene.as_dict() | {"sensors": [{**changed[0], "clock_hz": 435}]})


@pytest.mark.parametrize("clock_hz, warned", [(1000, True), (1200, True), (1035, False)])
def test_plan_warns_of_clock_on_lamp_lines(clock_hz, warned):
    """Without the warning, lamps give confident wrong readings at 1000 Hz."""
    found = [text for text in warnings(plan(scene_of(clock_hz))) if text.startswith("lamps")]
    assert bool(found) == warned
    if clock_hz == 1000:
        assert "lines 1, 2 and 4 of 'arm' lie within one bin" in found[0]
        assert "a clock of 1035 Hz they keep 30 Hz away" in found[0]


def test_plan_warns_of_stated_mains_only():
    """1080 Hz is a multiple of 120 Hz, which does not matter on a grid of 50 Hz."""

    def warned(mains_hz):
        environment = {"mains_hz": mains_hz}
        chosen = plan(scene_of(1080, environment=environment, phase_group={"snapshots": 1250}))
        return any(text.startswith("lamps") for text in warnings(chosen))

    assert [warned(hz) for hz in ("auto", 60, 50, None)] == [True, True, False, False]


def test_plan_short_groups_do_not_ask_for_clock_that_does_not_help():
    """Groups of 7 ms resolve 139 Hz: no clock keeps a bin away, so 1035 Hz is not warned of."""
    short = plan(scene_of(1035, phase_group={"snapshots": 125}))
    assert not any(text.startswith("lamps") for text in warnings(short))


BAND_CASES = [
    # carrier, rate, band, warned; edges from 47 CFR 15.247 and ERC 70-03
    (915e6, 12.5e6, "us-902-928", False),
    (908e6, 12.5e6, "us-902-928", True),  # 901.95 MHz
    (908.1e6, 12.5e6, "us-902-928", False),  # 902.05 MHz
    (866.5e6, 12.5e6, "eu-863-870", True),
    (866.5e6, 6.25e6, "eu-863-870", False),
    (2440e6, 12.5e6, "eu-2400-2483.5", False),
    (900e6, 12.5e6, None, False),
]


@pytest.mark.parametrize("carrier_hz, rate_hz, band, warned", BAND_CASES)
def test_plan_warns_outside_stated_band(carrier_hz, rate_hz, band, warned):
    """Transmitting outside the band is an offence that the file's writer wanted to avoid."""
    scene = scene_of(
        radio={"center_frequency_hz": 900e6, "sample_rate_hz": rate_hz}, environment={"band": band}
    )
    scene = with_carrier(scene, carrier_hz)
    found = list(outside_band(scene))
    assert bool(found) == warned
    assert all(f"environment.band {band} " in text for text in found)


def test_licence_note_names_no_band_only_without_stated_band():
    """One remark, and none where the user has decided or the band is free."""
    assert licence_note(with_carrier(scene_of(), 915e6)) is None
    assert "893.945 to 906.055 MHz" in licence_note(scene_of())
    assert licence_note(scene_of(environment={"band": "us-902-928"})) is None


def test_command_plan_prints_band_warning_and_note(tmp_path):
    """The command is where most users meet both."""
    text = "sensors: [{name: arm, model: line-900mhz, clock_hz: 1035}]\n"
    (tmp_path / "free.yaml").write_text(text)
    (tmp_path / "stated.yaml").write_text(text + "environment: {band: us-902-928}\n")

    def run(name):
        done = run_command("plan", tmp_path / name, "--json")
        return json.loads(done.stdout)

    free, stated = run("free.yaml"), run("stated.yaml")
    assert free["warnings"] == [] and len(free["notes"]) == 1
    assert stated["notes"] == [] and "us-902-928" in stated["warnings"][0]
