# SPDX-License-Identifier: GPL-3.0-or-later
"""Rooms are comparable and undescribed, and the judge of their readings counts what is wrong."""

import numpy as np
import pandas as pd
from second_simulator import FRAME, GROUP, RATE, phases, pressed

from rooms import radio
from rooms.judge import PHASES, Tally, failures, judge
from rooms.rooms import ROOMS, Capture, Room, scene_of


def test_seed_repeats_capture_and_effects_leave_others_alone():
    """Rooms can be compared only if all else stays equal."""
    first, again = (next(Capture(Room(duration_s=0.04), 3).blocks()) for _ in range(2))
    assert np.array_equal(first, again)
    room = Room((radio.DcOffset(0.05), radio.Bursts(0.2, 25)), duration_s=0.04)
    still, tag = Capture(room, 3).still, Capture(room, 3).tag
    plain = Capture(Room(duration_s=0.04), 3)
    assert np.array_equal(still, plain.still)
    assert np.array_equal(tag.switches.cycles, plain.tag.switches.cycles)


def test_scene_describes_nothing_of_the_room():
    """The reader is to be judged in rooms that nobody described."""
    for name, room in ROOMS.items():
        scene = scene_of(room)
        assert ("environment" in scene) == name.endswith("declared")
        assert len(scene["sensors"]) == 1


def test_judge_counts_what_is_wrong():
    """The score is worth what its rule is worth."""
    room, times = Room(), (np.arange(72) + 0.5) * GROUP * FRAME / RATE
    force, location = pressed(room.tag, times)
    touched = force >= 0.9
    rows = pd.DataFrame(phases(room.tag, force, location), columns=PHASES)
    rows = rows.assign(time_s=times, touch=touched.astype(int), interference=0.0)
    rows["flags"] = np.where(times < 0.45, "reference", None)
    for name, values in (("force_n", force), ("location_mm", location)):
        rows[name] = np.where(touched, values, np.nan)
    rows["force_std_n"] = rows["location_std_mm"] = np.where(touched, 0.05, np.nan)

    def figures(readings):
        return Tally([judge(room, readings)]).summary()

    right = figures(rows)
    assert [right[name] for name in ("wrong", "steady", "untouched")] == [0, 40, 22]
    assert right["all_phases_rms_deg"] < 1e-6
    assert failures(ROOMS["clean"], right) == ["std"]

    def changed(**fields):
        other = rows.copy()
        other.loc[25, list(fields)] = list(fields.values())  # in the hold of the first press
        return figures(other)

    off = force[25] + 0.4
    assert changed(force_n=off)["wrong"] == 1
    assert changed(force_n=off, flags="moved")["wrong"] == 0
    assert changed(force_n=off, force_std_n=0.2)["wrong"] == 0
    assert changed(force_n=force[25] + 0.2, force_std_n=0.01)["wrong"] == 0
    assert changed(location_mm=35.0)["wrong"] == 1
    assert changed(touch=0, force_n=np.nan)["missed"] == 1
    invented = figures(rows.assign(touch=rows["touch"].where(times < 2.56, 1)))
    assert invented["false_touches"] == invented["wrong"] > 0
