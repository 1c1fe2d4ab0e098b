# SPDX-License-Identifier: GPL-3.0-or-later
"""The generator of rooms makes what it says, measured in its samples; nothing is read here."""

from dataclasses import replace

import numpy as np
import pytest
from long_cases import cases
from second_simulator import FRAME, GROUP, RATE, phases, pressed, write_capture

from rooms import radio
from rooms.judge import failures, judge
from rooms.rooms import ROOMS, Capture, Room, mixture, room_named, scene_of

LINE = 0.2
CARRIERS = np.r_[-31:0, 1:32]


def channels(blocks):
    """Channel of every frame and subcarrier, (frames, 62)."""
    sent = np.exp(1j * np.pi * CARRIERS**2 / 64) * 64 / np.sqrt(62)
    folded = np.concatenate([block[:, 64:320].reshape(-1, 4, 64).mean(axis=1) for block in blocks])
    return np.fft.fft(folded)[:, CARRIERS] / sent


def line_db(channel, frequency_hz):
    """Power of a Doppler line, mean over subcarriers, relative to the tag's line 1."""
    t = np.arange(len(channel)) * FRAME / RATE
    window = np.hanning(len(t))
    tone = window * np.exp(-2j * np.pi * frequency_hz * t) / window.sum()
    return 10 * np.log10(np.mean(np.abs(tone @ channel) ** 2) / LINE**2)


def test_clean_capture_has_stated_levels():
    """Every level refers to the tag's line 1: a wrong reference would shift all rooms."""
    room = Room(duration_s=0.51)
    capture = Capture(room, 1)
    blocks = [block * capture.peak / 10 ** (-3 / 20) for block in capture.blocks()]
    channel = channels(blocks)
    still = channel.mean(axis=0)
    assert 10 * np.log10(np.mean(np.abs(still) ** 2) / capture.air.line**2) == pytest.approx(
        50, abs=0.1
    )
    offset = 1000 * (1 + 25e-6)
    changing = channel - still
    assert line_db(changing, offset) == pytest.approx(
        20 * np.log10(capture.air.line / LINE), abs=0.2
    )
    guard = np.concatenate(blocks)[:, 400:]
    noise = guard - guard.mean(axis=0)
    assert np.mean(np.abs(noise) ** 2) * 62 / 256 == pytest.approx(
        capture.air.line**2 / 10, rel=0.02
    )


def test_seed_repeats_capture_and_effects_leave_others_alone():
    """Rooms can be compared only if all else stays equal."""
    first, again = (next(Capture(Room(duration_s=0.04), 3).blocks()) for _ in range(2))
    assert np.array_equal(first, again)
    room = Room((radio.DcOffset(0.05), radio.Bursts(0.2, 25)), duration_s=0.04)
    still, tag = Capture(room, 3).still, Capture(room, 3).tag
    plain = Capture(Room(duration_s=0.04), 3)
    assert np.array_equal(still, plain.still)
    assert np.array_equal(tag.switches.cycles, plain.tag.switches.cycles)


@pytest.mark.parametrize("name", cases(*(f"mixture-{i}" for i in range(10)), long=ROOMS))
def test_capture_fits_the_converter(name, tmp_path):
    """Clipping that no room states would be one more effect; a low level would be quantized."""
    room = room_named(name)
    write_capture(Capture(replace(room, duration_s=0.04), 1).blocks(), tmp_path / "capture")
    codes = np.abs(np.fromfile(tmp_path / "capture.sigmf-data", "<i2").astype(int))
    overloaded = any(isinstance(e, radio.OverloadingBursts) for e in room.effects)
    assert codes.max() > 8000
    assert overloaded or codes.max() < 32000


def test_mixtures_repeat_and_differ():
    """A failing mixture must be found again by its number."""
    assert mixture(7) == mixture(7)
    rooms = [mixture(seed) for seed in range(40)]
    assert len({str(room) for room in rooms}) == 40
    assert {len(room.effects) for room in rooms} == {2, 3, 4}
    assert len({type(effect) for room in rooms for effect in room.effects}) >= 13


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
