# SPDX-License-Identifier: GPL-3.0-or-later
"""Rooms are comparable and undescribed, and the judge of their readings counts what is wrong."""

import numpy as np
from second_simulator import FRAME, GROUP, RATE, phases, pressed

from rooms import radio
from rooms.judge import failures, judge
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


def reading(time_s, force_n=0.0, location_mm=0.0, std=0.05, flags="", touch="1"):
    psi = phases(Room().tag, *(np.array([v]) for v in (force_n, location_mm or 40.0)))[0]
    return {
        "time_s": str(time_s),
        "touch": touch,
        "flags": flags,
        "force_n": str(force_n) if touch == "1" else "",
        "force_std_n": str(std) if touch == "1" else "",
        "location_mm": str(location_mm) if touch == "1" else "",
        "location_std_mm": str(std) if touch == "1" else "",
        "phase1_deg": str(psi[0]),
        "phase2_deg": str(psi[1]),
    }


def test_judge_counts_what_is_wrong():
    """The score is worth what its rule is worth."""
    room, period = Room(), GROUP * FRAME / RATE
    times = (np.arange(72) + 0.5) * period
    force, location = pressed(room.tag, times)
    rows = [
        reading(t, f, x, flags="reference" if t < 0.45 else "", touch=str(int(f >= 0.9)))
        for t, f, x in zip(times, force, location, strict=True)
    ]
    right = judge(room, rows)
    assert (right.wrong, right.steady, right.untouched) == (0, 40, 22)
    assert right.summary()["all_phases_rms_deg"] < 1e-6
    assert failures(ROOMS["clean"], right.summary()) == ["std"]

    def changed(**fields):
        held = next(i for i, t in enumerate(times) if t > 0.9)
        return judge(room, rows[:held] + [rows[held] | fields] + rows[held + 1 :])

    off = str(float(force[25]) + 0.4)
    assert changed(force_n=off).wrong == 1
    assert changed(force_n=off, flags="moved").wrong == 0
    assert changed(force_n=off, force_std_n="0.2").wrong == 0
    assert changed(force_n=str(float(force[25]) + 0.2), force_std_n="0.01").wrong == 0
    assert changed(location_mm="35.0").wrong == 1
    assert changed(touch="0", force_n="").missed == 1
    invented = [row | {"touch": "1"} if float(row["time_s"]) > 2.56 else row for row in rows]
    assert judge(room, invented).false_touches == judge(room, invented).wrong > 0
