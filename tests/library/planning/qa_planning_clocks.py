# SPDX-License-Identifier: GPL-3.0-or-later
"""Clocks of tags: what they cost each other, how many fit, and how far from lamps they lie."""

import itertools
import re

import numpy as np
import pytest
from command_runs import run_command
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.planning.advice import improve, warnings
from gnuradio.wiforce.planning.clocks import (
    assess_clocks,
    clocks_for,
    propose_clocks,
)
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene
from long_cases import cases
from plain import WAVEFORM, averaged_switches, make_plan

STRONG = (1, 2, 4)
BOTH = (50.0, 60.0)


def line_gap_hz(clocks_hz, tolerance_ppm):
    """Least distance of strong lines of two tags, clocks at either end of their tolerance."""
    errors = (1 - 1e-6 * tolerance_ppm, 1 + 1e-6 * tolerance_ppm)
    return min(
        abs(a * x * one - b * y * other)
        for one, other in itertools.combinations(clocks_hz, 2)
        for a, b, x, y in itertools.product(STRONG, STRONG, errors, errors)
    )


def lamp_gap_hz(clocks_hz, mains_hz=BOTH):
    """Least distance of strong lines of tags to a list of a lamp's lines."""
    lamps = np.concatenate([2 * hz * np.arange(200) for hz in mains_hz])
    return min(np.abs(m * hz - lamps).min() for hz in clocks_hz for m in STRONG)


def bin_hz(group_length):
    return 1 / (group_length * WAVEFORM.snapshot_period_s)


def scene_of(*clocks_hz, group_length=625, **sections):
    sensors = [
        {"name": f"s{i}", "model": "line-900mhz", "clock_hz": hz} for i, hz in enumerate(clocks_hz)
    ]
    return load_scene({"phase_group": {"snapshots": group_length}, "sensors": sensors} | sections)


def lamp_warnings(scene):
    return [text for text in warnings(plan(scene)) if text.startswith("lamps")]


def named_by_improve(scene):
    """Clocks that ``plan --improve`` names, by the index of the sensor."""
    changes = [p.change for p in improve(plan(scene)) if "clock_hz" in p.change]
    named = re.findall(r"sensors\[(\d+)\].clock_hz: ([\d.]+)", ", ".join(changes))
    return {int(index): float(hz) for index, hz in named}


def drawn_snapshots(clock_hz, phase, count=625, points=401):
    """Both switches averaged over every snapshot by counting instants; (n, 2)."""
    cycles = clock_hz * np.arange(count) * WAVEFORM.snapshot_period_s + phase
    return averaged_switches(cycles, clock_hz * WAVEFORM.averaging_s, points=points)


def information_of(waveforms):
    """Energy per snapshot of each column that the others and a constant do not explain."""
    found = []
    for i in range(waveforms.shape[1]):
        others = np.column_stack([np.delete(waveforms, i, axis=1), np.ones(len(waveforms))])
        fit = others @ np.linalg.lstsq(others, waveforms[:, i], rcond=None)[0]
        found.append(np.mean((waveforms[:, i] - fit) ** 2))
    return np.array(found)


@pytest.mark.parametrize("clocks_hz", [(1000.0,), (1000.0, 1400.0), (1000.0, 1790.0, 700.0)])
def test_assess_clocks_information_is_lowest_over_clock_phases(clocks_hz):
    report = assess_clocks(make_plan(clocks_hz))
    claimed = report.information
    rng = np.random.default_rng(5)
    found = []
    for _ in range(12):
        columns = [drawn_snapshots(clock_hz, rng.random(), points=64) for clock_hz in clocks_hz]
        found.append(information_of(np.hstack(columns)))
    # Of the worst phase: never above the mean of random ones, and within a tenth of the lowest.
    # Both drawn with 64 points a snapshot, which is good to 1 %.
    assert np.all(claimed < 1.01 * np.mean(found, axis=0))
    assert np.all(claimed > 0.9 * np.min(found, axis=0))


def test_assess_clocks_paper_tag_has_published_information():
    # q1, q2 at Ta = 20.48 us, known to three digits
    found = assess_clocks(make_plan([1000])).information
    assert found == pytest.approx([0.158, 0.152], abs=6e-4)


def test_assess_clocks_tag_at_twice_the_clock_is_not_readable():
    report = assess_clocks(make_plan([1000, 2000]))
    assert not report.readable
    # at this phase clock 1 of the second tag is clock 2 of the first
    pair = drawn_snapshots(1000, 0.0)[:, 1], drawn_snapshots(2000, -0.5)[:, 0]
    assert information_of(np.column_stack(pair)).max() < 1e-9


def test_assess_clocks_counts_all_of_a_long_group():
    """Long groups are what separates clocks that nearly coincide."""
    losses = [assess_clocks(make_plan([1000, 1005], n)).worst_loss_db for n in (1250, 2500, 5000)]
    assert losses == pytest.approx([2.14, 0.84, 0.67], abs=0.02)


@pytest.mark.parametrize("mains_hz", ["auto", 50, 60])
def test_distances_of_proposed_clocks_equal_a_search_over_lines_and_errors(mains_hz):
    """A wrong distance would recommend clocks that lamps or each other's lines disturb."""
    scene = scene_of(1000, 1400, environment={"mains_hz": mains_hz})
    for count in (2, 5, 9):
        found = clocks_for(scene, count)
        assert found.line_distance_hz == pytest.approx(line_gap_hz(found.clocks_hz, 100.0))
        lamps_hz = BOTH if mains_hz == "auto" else (mains_hz,)
        expected = [lamp_gap_hz([hz], lamps_hz) for hz in found.clocks_hz]
        assert found.lamp_distances_hz == pytest.approx(expected)


@pytest.mark.parametrize("group_length, tolerance_ppm", cases((625, 100.0), long=((1250, 500.0),)))
def test_propose_clocks_sixteen_tags_keep_apart_and_from_lamps(group_length, tolerance_ppm):
    """Lines that meet because crystals are off by their tolerance would swap two sensors."""
    clocks = propose_clocks(16, make_plan((), group_length), tolerance_ppm)
    assert len(set(clocks)) == 16
    bins = 2 if group_length == 1250 else 1.5
    assert line_gap_hz(clocks, tolerance_ppm) >= bins * bin_hz(group_length)
    assert max(clocks) * 4 <= 0.9 * 0.5 / WAVEFORM.snapshot_period_s
    assert assess_clocks(make_plan(clocks, group_length)).worst_loss_db < 1.5
    if group_length == 1250:  # in shorter groups, sixteen have no room beside the lines of lamps
        assert lamp_gap_hz(clocks) >= bin_hz(group_length)
        assert max(plan(scene_of(*clocks, group_length=group_length)).loss_db) < 1.0


@pytest.mark.parametrize("group_length", cases(125, long=(63, 250)))
def test_propose_clocks_too_many_names_the_number_that_fits(group_length):
    """A user must learn how many sensors are possible, and get them when asking for so many."""
    with pytest.raises(InputError, match="longer phase groups") as caught:
        propose_clocks(16, make_plan((), group_length))
    fitting = int(str(caught.value).split("at most ")[1].split(":")[0])
    clocks = propose_clocks(fitting, make_plan((), group_length))
    assert len(clocks) == fitting >= 2
    assert line_gap_hz(clocks, 100.0) >= bin_hz(group_length)
    plan(scene_of(*clocks, group_length=group_length))


def test_propose_clocks_clutter_leaves_no_room_raises():
    with pytest.raises(InputError, match="count: must be at most 0: .*, got 1"):
        propose_clocks(1, make_plan((), 64, 2000.0))


def test_proposed_clock_nearest_to_own_of_those_as_far_from_lamps():
    """Crystal and divider can often stay when the clock changes by little."""
    (near,), (free,) = (propose_clocks(1, make_plan(()), near_hz=own) for own in ([1400.0], []))
    assert near == 1365 and lamp_gap_hz([near]) == lamp_gap_hz([free]) == 30


@pytest.mark.parametrize(
    "scene, clocks_hz",
    [
        ("workshop_lamps", [1035.0]),
        ("two_sensors", [1035.0, 1365.0]),
        ("tabletop", None),
        (scene_of(1000.0, 1400.0, 800.0), None),
        (scene_of(120.0, group_length=300, packets={}), None),
    ],
)
def test_plan_warning_improve_and_proposal_name_the_same_clocks(scene, clocks_hz):
    """A tag builder who asks in two ways must not get two answers, of all tags at once."""
    scene = load_scene(scene)
    proposed = clocks_for(scene, len(scene.sensors)).clocks_hz
    assert clocks_hz is None or proposed == clocks_hz
    warned = {float(text.split("with a clock of ")[1].split()[0]) for text in lamp_warnings(scene)}
    assert warned and warned <= set(proposed)
    now = [sensor.clock_hz for sensor in scene.sensors]
    other = {i: hz for i, hz in enumerate(proposed) if hz != now[i]}
    assert named_by_improve(scene) == other


def test_clock_that_a_firmware_makes_stays_where_another_gains_little():
    """`design` makes 1033.0579 Hz; 4 Hz farther from lamps are not worth another crystal."""
    scene = scene_of(1033.0579)
    assert clocks_for(scene, 1).clocks_hz == [1033.0579]
    assert named_by_improve(scene) == {} and lamp_warnings(scene) == []


def test_plan_names_only_clocks_that_it_accepts():
    """At 3906 snapshots/s the ninth line of 435 Hz meets aliases: a scene with it is refused."""
    radio = {"radio": {"sample_rate_hz": 1.25e6}, "sounding": {"frame_length": 320}}
    scene = scene_of(400, group_length=125, **radio)
    (found,) = lamp_warnings(scene)
    plan(scene.with_clocks({0: float(found.split("with a clock of ")[1].split()[0])}))
    with pytest.raises(InputError, match="must leave the tag a line"):
        plan(scene.with_clocks({0: 435.0}))


@pytest.mark.parametrize(
    "clock_hz, mains_hz, group_length, warned",
    [
        (1000, "auto", 625, "lines 1, 2 and 4 of 's0' lie within one bin"),
        (1000, "auto", 625, "a clock of 1035 Hz they keep 30 Hz away"),
        (1200, "auto", 625, "lamps"),
        (1035, "auto", 625, None),
        (1080, 60, 1250, "lamps"),  # a multiple of 120 Hz, which does not matter at 50 Hz
        (1080, 50, 1250, None),
        (1080, None, 1250, None),
        (1035, "auto", 125, None),  # groups of 7 ms resolve 139 Hz: no clock keeps a bin away
    ],
)
def test_plan_warns_of_clock_on_lines_of_lamps(clock_hz, mains_hz, group_length, warned):
    """Without the warning, lamps give confident wrong readings at 1000 Hz."""
    environment = {"mains_hz": mains_hz}
    found = lamp_warnings(scene_of(clock_hz, group_length=group_length, environment=environment))
    assert (warned in found[0]) if warned else not found


def test_command_plan_clocks_lists_clocks_that_can_be_planned(tmp_path):
    """Designers of many sensors begin with their clocks, before they have a scene that works."""
    (tmp_path / "many.yaml").write_text("sensors: [{name: arm, model: line-900mhz}]\n")
    done = run_command("plan", tmp_path / "many.yaml", "--clocks", "4")
    lines = done.stdout.splitlines()
    clocks = [float(line.split()[1]) for line in lines if line.startswith("clock_hz: ")]
    plan(scene_of(*clocks))
    assert len(clocks) == 4
