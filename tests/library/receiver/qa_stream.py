# SPDX-License-Identifier: GPL-3.0-or-later
"""Streams in rooms that nobody described: surveyed like recordings, and again after a tare."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from chain_runs import assert_equal_readings, readings_of_reader
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.capture.folded_groups import Slips, SnapshotGroup, frame_settings
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.findings import findings
from gnuradio.wiforce.press.sensor_state import RETUNED
from gnuradio.wiforce.receiver.recording_reader import RecordingReader
from gnuradio.wiforce.receiver.stream import StreamReader
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.wiforce_kernels import folded_reader, interference_screen
from long_cases import cases
from press_capture import DEFAULT, run_flowgraph, source_of

# A quarter of the usual rate costs a quarter of the time.
GROUP_S = 320 * 320 / 3.2e6
SCENE = {
    "radio": {"sample_rate_hz": 3.2e6},
    "sounding": {"frame_length": 320},
    "phase_group": {"snapshots": 320},
    "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 1040}],
    "reference_s": 0.5,
    "simulation": {
        "duration_s": 2.0,
        "seed": 6,
        "snr_db": 10,
        "static_clutter_db": 50,
        "clock_offset_ppm": 40,
        "presses": [
            {"start_s": 1.5, "rise_s": 0.02, "hold_s": 0.35, "force_n": 4.0, "location_mm": 37.0}
        ],
    },
}
ROOM = {
    "other_tags": [{"clock_hz": 1230, "clock_offset_ppm": -35, "level_db": -5, "delay_s": 2e-8}],
    "lamps": {"mains_hz": 50, "level_db": 5},
}
TARE = 22  # the group with which the room changes, and a tare


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    """A quiet room and a busy one, with the same tag and the same press."""
    folder = tmp_path_factory.mktemp("rooms")
    for name, effects in (("quiet", {}), ("busy", ROOM)):
        scene = {**SCENE, "simulation": SCENE["simulation"] | effects}
        simulate(load_scene(scene), folder / name)
    return folder


@pytest.fixture(scope="module")
def groups(captures):
    """Collected groups of both rooms, by name."""
    return {name: collected(captures / name) for name in ("quiet", "busy")}


@cache
def settings():
    """The plan of the scene."""
    return wiforce.plan(SCENE)


def collected(capture):
    """The groups of a capture."""
    length, waveform = settings().group_length, settings().waveform
    got = folded_reader(**frame_settings(open_capture(capture), waveform, 0)).read(10**6)
    screen, everything = interference_screen(length, 64), np.ones(length, bool)
    found = []
    for g in range(len(got["folded"]) // length):
        rows = slice(g * length, (g + 1) * length)
        folded = got["folded"][rows]
        kept = ~screen.examine(everything, folded, got["noise"][rows])
        found.append(SnapshotGroup(g, folded, everything, kept))
    return found


def stream(received, tare=None, batch=1, again_s=10.0):
    """A reader of a stream, its readings, and its plan after each group."""
    reader, readings, plans = StreamReader(settings(), survey_again_s=again_s), [], []
    for first in range(0, len(received), batch):
        if tare is not None and first == tare:
            reader.tares.request()
        readings += reader.process(received[first : first + batch])
        plans.append(reader.plan)
    return reader, readings + reader.finish(), plans


def test_groups_before_a_slip_are_left_out_of_a_tare(groups):
    """Readings went on with a reference that held frames of elsewhere."""
    received = list(groups["quiet"])
    first, length = TARE + 5, len(received[0].present)
    moved = np.roll(received[first].folded, 7, axis=1)
    received[first] = replace(received[first], folded=moved)
    frames = [(first * length, (first + 1) * length)]
    received[first + 1] = replace(received[first + 1], misplaced=frames)
    found = {}
    for batch in (1, TARE // 2):
        reader, readings, _ = stream(received, tare=TARE, batch=batch)
        assert reader.tares.state.state == "complete"
        assert_right(readings)
        found[batch] = as_rows(readings)
    assert found[1] == found[TARE // 2]


def as_rows(readings):
    return [reading.row() for reading in readings]


def assert_right(readings):
    """The press is read, and every unflagged reading holds."""
    touched = [r for r in readings if r.touch == 1 and not r.flags]
    assert len(touched) >= 5
    for reading in touched:
        assert abs(reading.force_n - 4.0) < 4 * reading.force_std_n
        assert abs(reading.location_mm - 37.0) < 0.3
    assert np.median([abs(reading.force_n - 4.0) for reading in touched]) < 0.15


@pytest.mark.parametrize("input_type", cases("folded", long=("sc16",)))
def test_stream_of_a_busy_room_is_read_as_its_recording(captures, input_type):
    """Live readings must not be worse than those of a recording of the same samples."""
    recorded = RecordingReader(open_capture(captures / "busy"), settings())
    wanted = [reading for batch in recorded for reading in batch]
    readings = []
    reader = wiforce.reader(SCENE, input_type=input_type, on_reading=readings.append)
    run_flowgraph(source_of(captures / "busy", SCENE, input_type), reader)
    assert reader.failure is None
    assert len(readings) == len(wanted) == int(2.0 / GROUP_S)
    assert_equal_readings(readings, wanted)
    assert_right(readings)
    assert reader.findings == findings(recorded.survey, settings(), recorded.plan)
    assert {finding.kind for finding in reader.findings} == {"lamps", "tag"}
    assert reader.plan.others == recorded.plan.others and len(reader.plan.others) == 1


def test_stream_of_a_quiet_room_keeps_the_plan(groups):
    """A survey must cost nothing where there is nothing to find, a tare included."""
    reader, readings, _ = stream(groups["quiet"], tare=TARE)
    assert reader.plan is settings() and reader.findings == []
    assert [r.time_s for r in readings] == pytest.approx(
        [(g + 0.5) * GROUP_S for g in range(len(groups["quiet"]))]
    )
    assert_right(readings)


@pytest.fixture(scope="module")
def quiet(groups):
    """Readings of the quiet room."""
    return stream(groups["quiet"])[1]


@pytest.fixture(scope="module")
def changing(groups):
    """Groups of a room that changes."""
    return groups["quiet"][:TARE] + groups["busy"][TARE:]


@pytest.fixture(scope="module")
def tared(changing):
    """The stream of that room, with a tare: reader, readings, and plans."""
    return stream(changing, TARE)


def test_stream_room_that_changes_is_surveyed_with_the_tare_and_no_group_is_lost(
    groups, quiet, changing, tared
):
    """Somebody switches on lamps and a second tag, and tares."""
    reader, readings, plans = tared
    assert as_rows(stream(changing, TARE, 11)[1]) == as_rows(readings)
    busy = stream(groups["busy"])[1]
    # The weights change when the new reference is complete and no slip can be found in it any more,
    # and nothing has touched the sensor.
    switch = TARE + settings().reference_groups + Slips(settings().group_length).unsure
    assert plans[switch - 2] is settings() and plans[switch - 1] is reader.plan is not settings()
    assert {finding.kind for finding in reader.findings} == {"lamps", "tag"}
    assert [r.time_s for r in readings] == [r.time_s for r in quiet]
    assert reader.counts.groups == len(changing)
    assert as_rows(readings[:TARE]) == as_rows(quiet[:TARE])
    assert_right(readings)
    for got, want in zip(readings[switch:], busy[switch:], strict=True):
        assert got.touch == want.touch and "gap" not in got.flags
        assert got.phase1_deg == pytest.approx(want.phase1_deg, abs=0.4)
    # Without the survey, the same readings are much less certain.
    unaware = stream(changing)[1]
    held = slice(-9, -4)
    stds = [[r.force_std_n for r in each[held]] for each in (readings, unaware)]
    assert np.mean(stds[0]) < 0.7 * np.mean(stds[1])


def test_stream_tare_that_changes_the_weights_is_believed(groups):
    """After the device was opened again, a tare ends the doubt, whatever the survey finds."""
    reader = StreamReader(settings())
    for group in groups["quiet"][:TARE]:
        reader.process([group])
    receiver = reader._receiver
    ((name, state),) = receiver.states.items()
    state.retuned = True
    assert reader.reference_problem(name) == RETUNED
    before = reader.plan
    reader.tares.request()
    for group in groups["busy"][TARE : TARE + 2 * before.reference_groups]:
        reader.process([group])
    assert reader.plan is not before and reader.tares.state.state == "complete"
    assert reader.reference_problem(name) == ""
    # Another receiver knows what presses have shown before, as ends that are swapped.
    assert reader._receiver is not receiver and reader._receiver.states[name] is state


@pytest.mark.parametrize("force, ends", [(False, "failed"), (True, "complete")])
def test_stream_touched_tare_is_no_survey(groups, force, ends):
    """A press at group 46 begins within the tare: the room is not the untouched one."""
    reader = StreamReader(settings())
    assert reader.tares.request().state == "refused" and reader.state == "acquiring"
    for index, group in enumerate(groups["quiet"]):
        if index == 40:
            first = reader.survey
            assert reader.tares.request(force).state == "measuring"
        reader.process([group])
    assert reader.tares.state.state == ends and reader.survey is first is not None
    assert reader.plan is settings()


def test_stream_state_is_that_of_one_receiver(groups):
    """Weights may be exchanged between any two looks of the thread that asks."""

    class Interrupted(StreamReader):
        @property
        def _exchanged(self):
            self._use(self.plan)
            return ""

        @_exchanged.setter
        def _exchanged(self, state):
            pass

    reader = Interrupted(settings())
    reader.process(groups["quiet"][:TARE])
    assert reader.state == "reading"


@pytest.mark.parametrize(
    "error", [InputError("tag", "is one of two", 2), np.linalg.LinAlgError("SVD did not converge")]
)
def test_stream_room_that_cannot_be_planned_for_is_read_with_the_present_weights(
    changing, monkeypatch, error
):
    """A reader that nobody attends must not end because of what a survey has found."""

    def fail(*_):
        raise error

    monkeypatch.setattr("gnuradio.wiforce.receiver.stream.readapted", fail)
    _, readings, plans = stream(changing, TARE)
    assert all(plan is settings() for plan in plans)
    assert [reading.group for reading in readings] == list(range(len(changing)))
    touched = [r for r in readings if r.touch == 1 and not r.flags]
    assert len(touched) >= 5
    assert all(abs(r.force_n - 4.0) < 4 * r.force_std_n for r in touched)


def test_stream_room_is_surveyed_again_without_a_tare_while_nothing_is_touched(
    quiet, changing, tared
):
    """Nobody tells the reader that lamps were switched on: it has to find out."""
    reader, readings, plans = stream(changing, again_s=0.25)
    # Surveys after the reference end with group 12, and with 12 + 8 + 16; 46 is the press.
    changes = [g for g in range(1, len(plans)) if plans[g] is not plans[g - 1]]
    assert changes == [36]
    assert {finding.kind for finding in reader.findings} == {"lamps", "tag"}
    assert [r.time_s for r in readings] == [r.time_s for r in quiet]
    assert as_rows(readings[:TARE]) == as_rows(quiet[:TARE])
    assert_right(readings)
    for got, want in zip(readings[-12:], tared[1][-12:], strict=True):
        assert (got.touch, got.flags) == (want.touch, want.flags)
        assert got.phase1_deg == pytest.approx(want.phase1_deg, abs=0.4)
    assert as_rows(stream(changing, None, 11, 0.25)[1]) == as_rows(readings)


def test_stream_touched_groups_are_never_a_new_reference(groups, quiet):
    """A press during a survey that nobody asked for would be taken for the untouched sensor."""
    press = [g for g, r in enumerate(quiet) if r.touch]
    received = groups["quiet"][: press[0] - 5] + groups["busy"][press[0] - 5 :]
    # Surveys begin with groups 16 and 35: the second one would end with 50, in the press.
    reader, readings, plans = stream(received, again_s=0.1)
    assert all(plan is settings() for plan in plans) and reader.findings == []
    assert any(r.touch for r in readings[46:])
    assert not any("reference" in r.flags for r in readings[20:])


@pytest.fixture(scope="module")
def held(tmp_path_factory, long_run):
    """A press of two seconds, in both rooms, and before it a tag that is not received."""
    folder = tmp_path_factory.mktemp("held")
    press = {**SCENE["simulation"]["presses"][0], "start_s": 0.7, "hold_s": 1.7}
    simulation = SCENE["simulation"] | {"presses": [press], "duration_s": 2.8}
    effects = {"quiet": {}, "busy": ROOM}
    if long_run:
        effects["silent"] = {"snr_db": -60, "static_clutter_db": 120}
    for name, effect in effects.items():
        simulate(load_scene({**SCENE, "simulation": simulation | effect}), folder / name)
    return {name: collected(folder / name) for name in effects}


@pytest.mark.parametrize("how", cases("tare forced", long=("reference lost", "tag silent")))
def test_stream_doubtful_reference_is_not_replaced_by_pressed_phases(held, how):
    """Lamps switched on under a press must not turn 4 N into 'untouched', without a flag."""
    begin, change, reader = 22, 40, StreamReader(settings(), survey_again_s=0.25)
    before = {"tare forced": "quiet", "tag silent": "silent"}.get(how)
    received = held[before][:begin] if before else []
    received = received + held["quiet"][begin:change] + held["busy"][change:]
    readings = []
    for group in received:
        if how == "tare forced" and group.index == begin + 5:
            reader.tares.request(force=True)
        readings += reader.process([group])
    readings += reader.finish()
    pressed = [r for r in readings if 24 <= r.group < 75]
    assert len(pressed) == 51
    assert [r.group for r in pressed if r.touch == 0 and not r.flags] == []


def test_stream_room_is_not_surveyed_across_lost_groups(groups):
    """A press that begins while nothing is received would be taken for the untouched sensor."""
    # The survey that begins with group 35 would take 16 groups; the press holds until group 58.
    received = groups["quiet"][:37] + groups["busy"][37:41] + groups["busy"][55:]
    _, readings, plans = stream(received, again_s=0.1)
    assert all(plan is settings() for plan in plans)
    assert not any("reference" in r.flags for r in readings[20:])
    pressed = [r for r in readings if r.group in (55, 56, 57)]
    assert [r.touch for r in pressed] == [1, 1, 1]


def test_stream_with_a_gap_in_the_reference_is_surveyed_in_the_rest(groups):
    received = groups["busy"][:3] + groups["busy"][5:]
    reader, readings, _ = stream(received)
    assert len(readings) == len(groups["busy"]) and reader.counts.dropped == 2
    assert [("gap" in r.flags) for r in readings[:6]] == [False] * 3 + [True] * 2 + [False]
    assert {finding.kind for finding in reader.findings} >= {"tag"}
    assert_right(readings)


def test_stream_of_a_clock_without_crystal_is_read(tmp_path):
    """The clock is measured by the survey, and tracked by weights for its own frequency."""
    sensor = SCENE["sensors"][0] | {"clock_tolerance_ppm": 20_000}
    own = {"duration_s": 1.0, "clock_offset_ppm": 12_000}
    # The force has risen before the group at 0.608 s: a reading is of the mean over its group.
    own["presses"] = [SCENE["simulation"]["presses"][0] | {"start_s": 0.588}]
    scene = {**SCENE, "sensors": [sensor], "simulation": SCENE["simulation"] | own}
    simulate(load_scene(scene), tmp_path / "wide")
    readings = []
    reader = wiforce.reader(scene, input_type="folded", on_reading=readings.append)
    run_flowgraph(wiforce.capture_source(tmp_path / "wide", scene), reader)
    assert reader.failure is None
    assert reader.plan.clocks_hz[0] == pytest.approx(1040 * 1.012, abs=0.1)
    assert_right(readings)


def test_stream_of_a_compressing_receiver_is_read_as_its_recording(tmp_path):
    """A program would read other forces live than from the recording of the same samples."""
    scene = DEFAULT | {"simulation": DEFAULT["simulation"] | {"front_end": {"compression": 0.03}}}
    simulate(load_scene(scene), tmp_path / "a")
    recorded = RecordingReader(open_capture(tmp_path / "a"), scene)
    assert recorded.plan.compression is not None
    wanted = [reading for batch in recorded for reading in batch]
    assert_equal_readings(readings_of_reader(scene, source_of(tmp_path / "a", scene)), wanted)
