# SPDX-License-Identifier: GPL-3.0-or-later
"""Samples that were lost without a trace: frame timing slips, and readings go on."""

import copy
import json
import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from chain_runs import readings_of_reader
from gnuradio import gr, wiforce
from gnuradio.wiforce.estimation.capture import folded_groups
from gnuradio.wiforce.estimation.capture.folded_groups import Slips, SnapshotGroup
from gnuradio.wiforce.receiver.stream import GroupsInPlace
from long_cases import cases
from press_capture import DEFAULT, codes_of, source_of

# Half the usual rate takes half the time; frames and groups last as long, and half of a frame is
# silent, as usual.
RATE_HZ, FRAME = 6.25e6, 360
SCENE = DEFAULT | {
    "radio": {"sample_rate_hz": RATE_HZ},
    "sounding": {"frame_length": FRAME, "repetitions": 2},
}


ANTENNAS = ("", ".antenna2")  # suffixes of their captures


def scene_of(antennas):
    """A press of 4 N from 0.8 s on; two antennas are of a receiver with its own clock."""
    scene = copy.deepcopy(SCENE) | {"reference_s": 0.5}
    clock = "free" if antennas == 2 else "shared"
    scene["environment"] = {"reader_clock": clock, "receive_antennas": antennas}
    scene["simulation"]["duration_s"] = 1.4
    scene["simulation"]["presses"][0]["start_s"] = 0.8
    return scene


@pytest.fixture(scope="module")
def press(tmp_path_factory):
    """The capture by so many antennas."""

    @cache
    def captured(antennas):
        name = tmp_path_factory.mktemp("slip") / "press"
        wiforce.simulate(scene_of(antennas), name)
        return name

    return captured


@pytest.fixture(scope="module")
def whole(press):
    """Its readings where nothing is lost."""
    return cache(lambda antennas: wiforce.read(press(antennas)))


def slipped(capture, folder, at_s, *lost):
    """The capture without some samples of each antenna, or with more of them."""
    for suffix, count in zip(ANTENNAS, lost, strict=False):
        codes, at = codes_of(f"{capture}{suffix}"), int(at_s * RATE_HZ)
        if count > 0:
            codes = np.delete(codes, slice(at, at + count), axis=0)
        else:
            codes = np.insert(codes, [at] * -count, codes[at], axis=0)
        codes.tofile(f"{folder / 'a'}{suffix}.sigmf-data")
        shutil.copy(f"{capture}{suffix}.sigmf-meta", f"{folder / 'a'}{suffix}.sigmf-meta")
    return folder / "a"


def assert_only_groups_of_a_slip_are_lost(readings, whole):
    """A slip is found after 1072 frames at most, 62 ms, and groups last 36 ms."""
    assert 1 <= readings["flags"].str.contains("gap").sum() <= 4
    steady = (whole["flags"] == "") & (whole["time_s"] > 0.55)
    found = readings.set_index("group").loc[whole.loc[steady, "group"]]
    assert (found["flags"] == "").mean() > 0.85
    change = found["force_n"].to_numpy() - whole.loc[steady, "force_n"].to_numpy()
    assert np.isfinite(change).sum() > 5 and np.nanmax(np.abs(change)) < 0.2


@pytest.mark.parametrize(
    ("at_s", "lost"),
    cases((0.1, 1), long=((0.4, 17), (0.02, -150), (0.25, -1250))),
)
def test_samples_lost_within_the_reference_cost_their_groups_only(
    press, whole, tmp_path, at_s, lost
):
    """The reference continues behind a slip: a single sample flagged the whole recording.

    Less than none are lost where some are inserted, which looks like a loss of most of a frame.
    """
    found = wiforce.read(slipped(press(1), tmp_path, at_s, lost))
    assert_only_groups_of_a_slip_are_lost(found, whole(1))


@pytest.mark.parametrize("lost", cases([-1, -1], long=([1, 0],)))
def test_samples_lost_at_two_antennas_cost_their_groups_only(press, whole, tmp_path, lost):
    """Frames that lay elsewhere entered the ratio, and the reference was that of noise."""
    found = wiforce.read(slipped(press(2), tmp_path, 0.25, *lost))
    assert_only_groups_of_a_slip_are_lost(found, whole(2))


def read_as_a_stream(capture, antennas, input_type):
    """Readings of a capture whose samples, or folded frames, pass a flowgraph."""
    scene = scene_of(antennas)
    if antennas == 1:
        source = source_of(capture, scene, input_type)
        return readings_of_reader(scene, source, input_type=input_type)
    found, flowgraph, ratio = [], gr.top_block(), wiforce.antenna_ratio()
    reader = wiforce.reader(scene, input_type=input_type, on_reading=found.append)
    for port, suffix in enumerate(ANTENNAS):
        flowgraph.connect(wiforce.capture_source(f"{capture}{suffix}", scene), (ratio, port))
    flowgraph.connect(ratio, reader)
    flowgraph.run()
    assert reader.failure is None
    return found


@pytest.mark.parametrize(
    ("antennas", "input_type", "at_s", "lost"),
    cases(
        *((1, "sc16", 0.25, -1), (2, "folded", 0.25, -1)),
        long=((1, "sc16", 0.02, 150), (1, "folded", 0.1, 1)),
    ),
)
def test_slip_within_the_reference_reads_alike_from_file_and_stream(
    press, tmp_path, antennas, input_type, at_s, lost
):
    """A stream took frames before the slip into its reference, and flagged all that followed."""
    capture = slipped(press(antennas), tmp_path, at_s, *[lost] * antennas)
    wanted = wiforce.read(capture)
    found = read_as_a_stream(capture, antennas, input_type)
    assert wanted["flags"].str.contains("gap").any()
    assert [" ".join(reading.flags) for reading in found] == wanted["flags"].tolist()
    for column in ("force_n", "phase1_deg", "time_s"):
        values = np.array([getattr(reading, column) for reading in found], float)
        np.testing.assert_allclose(values, wanted[column], atol=2e-3)


def test_slip_that_a_stream_finds_during_a_press_leaves_no_wrong_reading(press, tmp_path):
    """Readings are given before a slip is found: they are flagged then, and go on behind it."""
    found = read_as_a_stream(slipped(press(1), tmp_path, 0.9, 1), 1, "sc16")
    touched = [reading for reading in found if reading.touch == 1 and not reading.flags]
    assert len(touched) >= 5 and sum("gap" in reading.flags for reading in found) == 1
    assert max(abs(reading.force_n - 4.0) for reading in touched) < 0.2


@pytest.mark.parametrize(("antennas", "groups"), [(1, 3), (2, 1)])
def test_slip_behind_the_groups_that_are_read_at_once_reads_alike(
    press, tmp_path, monkeypatch, antennas, groups
):
    """What was read before a slip was found depended on how much was read at once, and a recording
    of two antennas ended where all of it lay before the slip.
    """
    capture = slipped(press(antennas), tmp_path, 0.02, *[1] * antennas)
    wanted = wiforce.read(capture)
    monkeypatch.setattr(folded_groups, "_BATCH", groups)
    pd.testing.assert_frame_equal(wiforce.read(capture), wanted)


def test_antennas_that_lost_other_frames_are_read_to_their_end(press, whole, tmp_path, monkeypatch):
    """Frames that both had were compared as far as they were read at once, and a recording ended
    where none of them were common.
    """
    for suffix, first in zip(ANTENNAS, (0.6, 0.8), strict=True):
        codes = codes_of(f"{press(2)}{suffix}")
        start, end = (FRAME * round(at_s * RATE_HZ / FRAME) for at_s in (first, first + 0.15))
        np.delete(codes, slice(start, end), axis=0).tofile(f"{tmp_path / 'a'}{suffix}.sigmf-data")
        meta = json.loads(Path(f"{press(2)}{suffix}.sigmf-meta").read_text())
        meta["captures"] += [{"core:sample_start": start, "core:global_index": end}]
        Path(f"{tmp_path / 'a'}{suffix}.sigmf-meta").write_text(json.dumps(meta))
    wanted = wiforce.read(tmp_path / "a")
    assert 8 <= wanted["flags"].str.contains("gap").sum() <= 12
    pd.testing.assert_series_equal(wanted["group"], whole(2)["group"])
    monkeypatch.setattr(folded_groups, "_BATCH", 4)
    pd.testing.assert_frame_equal(wiforce.read(tmp_path / "a"), wanted)


def test_group_left_out_before_a_slip_passes_on_that_the_device_was_tuned():
    """Its phases are new for all that follow, though nothing of the group itself is read."""
    plan = wiforce.plan(SCENE)
    length, first = plan.group_length, plan.reference_groups + 20
    in_place = GroupsInPlace(length, plan.reference_groups)

    def group(index, **found):
        folded = np.zeros((length, plan.waveform.symbol_length), np.complex64)
        present = np.ones(length, bool)
        return SnapshotGroup(index, folded, present, present, **found)

    begin = first * length
    given = in_place.process(
        [
            group(first, retuned=True, misplaced=[(begin, begin + 9)]),
            group(first + 1),
            group(first + 2),
        ]
    )
    assert [(each.index, each.retuned, each.slipped) for each in given] == [
        (first + 1, True, True),
        (first + 2, False, False),
    ]


def test_retuning_in_groups_left_out_marks_the_next_one():
    """What the receiver did would be read as done by the sensor."""
    slips = Slips(10)
    slips.add([(32, 45)], [25, 36, 77])
    marks = [slips.mark(group) for group in range(1, 6)]
    assert marks == [(False, False), (False, True), None, None, (True, True)]
    slips.add([(32, 45)], [25, 36, 77])  # kernels give all of them again
    assert [slips.mark(group) for group in (6, 9)] == [(False, False), (False, True)]


def test_slips_of_the_past_are_forgotten():
    """A device that loses samples for days would be read slower and slower."""
    slips = Slips(625)
    for group in range(0, 4000, 2):
        slips.add([(625 * group, 625 * group + 5)])
        assert slips.mark(group) is None and slips.mark(group + 1) == (True, False)
        assert len(slips._misplaced) <= 1
