# SPDX-License-Identifier: GPL-3.0-or-later
"""Clocks of many tags: distances of all strong lines, and how many fit."""

import itertools

import numpy as np
import pytest
from command_runs import refused, run_command
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.planning.advice import improve
from gnuradio.wiforce.planning.clocks import (
    assess_clocks,
    line_distances_hz,
    propose_clocks,
)
from gnuradio.wiforce.planning.plan import plan
from long_cases import cases
from plain import WAVEFORM, make_plan

STRONG = (1, 2, 4)


def line_gap_hz(clocks_hz, tolerance_ppm):
    """Least distance of strong lines of two tags, clocks at either end of their tolerance."""
    errors = (1 - 1e-6 * tolerance_ppm, 1 + 1e-6 * tolerance_ppm)
    return min(
        abs(a * x * one - b * y * other)
        for one, other in itertools.combinations(clocks_hz, 2)
        for a, b, x, y in itertools.product(STRONG, STRONG, errors, errors)
    )


def bin_hz(group_length):
    return 1 / (group_length * WAVEFORM.snapshot_period_s)


def scene_of(clocks_hz, group_length, **sections):
    sensors = [
        {"name": f"s{i}", "model": "line-900mhz", "clock_hz": hz} for i, hz in enumerate(clocks_hz)
    ]
    return {"phase_group": {"snapshots": group_length}, "sensors": sensors, **sections}


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
        lamps = np.concatenate([2 * hz * np.arange(200) for hz in (50.0, 60.0)])
        gaps = [np.abs(m * hz - lamps).min() for hz in clocks for m in STRONG]
        assert min(gaps) >= bin_hz(group_length)
        assert max(plan(scene_of(clocks, group_length)).loss_db) < 1.0


@pytest.mark.parametrize("group_length", cases(125, long=(63, 250)))
def test_propose_clocks_too_many_names_the_number_that_fits(group_length):
    """A user must learn how many sensors are possible, and get them when asking for so many."""
    with pytest.raises(InputError, match="longer phase groups") as caught:
        propose_clocks(16, make_plan((), group_length))
    fitting = int(str(caught.value).split("at most ")[1].split(":")[0])
    clocks = propose_clocks(fitting, make_plan((), group_length))
    assert len(clocks) == fitting >= 2
    assert line_gap_hz(clocks, 100.0) >= bin_hz(group_length)
    plan(scene_of(clocks, group_length))


def test_propose_clocks_are_readable_beside_those_taken():
    proposed = propose_clocks(2, make_plan((1000.0,)))
    assert len(proposed) == 2
    assert line_gap_hz([1000, *proposed], 100.0) >= 2 * bin_hz(625)
    report = assess_clocks(make_plan([1000, *proposed]))
    assert report.readable and report.worst_loss_db < 1.2


def test_assess_clocks_counts_all_of_a_long_group():
    """Long groups are what separates clocks that nearly coincide."""
    losses = [assess_clocks(make_plan([1000, 1005], n)).worst_loss_db for n in (1250, 2500, 5000)]
    assert losses == pytest.approx([2.14, 0.84, 0.67], abs=0.02)


def test_propose_clocks_clutter_leaves_no_room_raises():
    with pytest.raises(InputError, match="count: must be at most 0: .*, got 1"):
        propose_clocks(1, make_plan((), 64, 2000.0))


@pytest.mark.parametrize("seed", range(4))
def test_line_distances_equal_search_over_lines_and_errors(seed):
    """The table decides for all pairs at once what a comparison of lines would."""
    rng = np.random.default_rng(seed)
    clocks = rng.uniform(200, 2100, 12)
    found = line_distances_hz(clocks[:, None], clocks, 300.0)
    for i, j in itertools.combinations(range(12), 2):
        expected = line_gap_hz((clocks[i], clocks[j]), 300.0)
        nominal = line_gap_hz((clocks[i], clocks[j]), 0.0)
        # Within reach of the tolerance lines may coincide between its two ends.
        assert found[i, j] == pytest.approx(expected) or found[i, j] == 0 < nominal < 5


def test_command_plan_clocks_lists_clocks_that_can_be_planned(tmp_path):
    """Designers of many sensors begin with their clocks, before they have a scene that works."""
    (tmp_path / "many.yaml").write_text("sensors: [{name: arm, model: line-900mhz}]\n")
    done = run_command("plan", tmp_path / "many.yaml", "--clocks", "12")
    lines = done.stdout.splitlines()
    clocks = [float(line.split()[1]) for line in lines if line.startswith("clock_hz: ")]
    plan(scene_of(clocks, 625))
    apart_hz = float(next(line for line in lines if "apart" in line).split(" lie ")[1].split()[0])
    assert len(clocks) == 12 and apart_hz == pytest.approx(line_gap_hz(clocks, 100.0), rel=5e-3)


def test_command_plan_more_clocks_than_fit_is_refused_in_one_line(tmp_path):
    """The number that fits is what the user needs in order to go on."""
    text = "sensors: [{name: arm, model: line-900mhz}]\nphase_group: {snapshots: 63}\n"
    (tmp_path / "short.yaml").write_text(text)
    said = refused("plan", tmp_path / "short.yaml", "--clocks", "16")
    assert "--clocks: must be at most 3: no more are found" in said


def test_improve_names_clocks_for_all_tags_that_lamps_disturb():
    """Changing one clock at a time does not help where all of them lie on lines of lamps."""
    found = improve(plan(scene_of([1000.0, 1400.0, 800.0], 625)))
    (change,) = [p.change for p in found if "clock_hz" in p.change]
    clocks = [float(each.split(": ")[1]) for each in change.split(", ")]
    assert len(clocks) == 3
    assert line_gap_hz(clocks, 100.0) >= 2 * bin_hz(625)
    lamps = np.concatenate([2 * hz * np.arange(200) for hz in (50.0, 60.0)])
    assert min(np.abs(m * hz - lamps).min() for hz in clocks for m in STRONG) >= bin_hz(625)
