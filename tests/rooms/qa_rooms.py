# SPDX-License-Identifier: GPL-3.0-or-later
"""The generator of rooms makes what it says, measured in its samples; nothing is read here."""

from dataclasses import replace

import numpy as np
import pytest
from long_cases import cases
from second_simulator import FRAME, GROUP, RATE, frame, phases, pressed, write_capture

from rooms import effects, radio, reflections
from rooms.judge import failures, judge
from rooms.rooms import ROOMS, Capture, Room, mixture, room_named, scene_of

LINE, NOISE = 0.2, 0.05
FRAMES = 14 * GROUP  # 0.5 s
CARRIERS = np.r_[-31:0, 1:32]


def begun(effect, frames=FRAMES, seed=1):
    effect.begin(effects.Air(LINE, NOISE, frame(), frames), np.random.default_rng(seed))
    return effect


def added(effect, frames=FRAMES):
    """What an effect adds at the antenna, a group at a time."""
    for first in range(0, frames, GROUP):
        block = np.zeros((GROUP, FRAME), complex)
        effect.add(block, first)
        yield block


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


def test_seed_repeats_capture_and_effects_leave_others_alone():
    """Rooms can be compared only if all else stays equal."""
    first, again = (next(Capture(Room(duration_s=0.04), 3).blocks()) for _ in range(2))
    assert np.array_equal(first, again)
    room = Room((radio.DcOffset(0.05), radio.Bursts(0.2, 25)), duration_s=0.04)
    still, tag = Capture(room, 3).still, Capture(room, 3).tag
    plain = Capture(Room(duration_s=0.04), 3)
    assert np.array_equal(still, plain.still)
    assert np.array_equal(tag.switches.cycles, plain.tag.switches.cycles)


def test_lamp_lines_fall_with_the_harmonic():
    """The level is stated at 1 kHz, where the tag is; each of two lines has half the amplitude."""
    lamps = begun(reflections.Lamps(-10, wander_hz=0.0), seed=2)
    channel = channels(added(lamps))
    mains = (lamps.turns[-1] - lamps.turns[0]) / (FRAMES * FRAME / RATE)

    def level(h):
        return line_db(channel, h * mains) - 20 * np.log10(np.sinc(h * mains * 256 / RATE))

    assert level(10) == pytest.approx(-10 - 6.02, abs=0.1)
    # Three lamps add with random phases: the other lines have their level on average.
    others = [level(h) + 20 * np.log10(abs(h)) for h in range(-30, 31) if h]
    assert 10 * np.log10(np.mean(10 ** (np.array(others) / 10))) == pytest.approx(3.98, abs=1.5)
    assert abs(np.mean(others[:15]) - np.mean(others[15:30])) < 3
    assert line_db(channel, 1.5 * mains) < -60


@pytest.mark.parametrize(("clock", "level"), [(1300, -10), (500, 20)])
def test_other_tag_has_its_level_on_its_own_line(clock, level):
    """An unlisted tag is to be as strong as its room's name says."""
    tag = begun(effects.OtherTag(clock, level, offset_ppm=30.0))
    channel = channels(added(tag))
    expected = level + 20 * np.log10(0.25 * np.sinc(0.25) * np.sinc(clock * 256 / RATE) / LINE)
    assert line_db(channel, clock * (1 + 30e-6)) == pytest.approx(expected, abs=0.1)
    assert line_db(channel, 3 * clock * (1 + 30e-6)) < expected - 9


@pytest.mark.parametrize(("share", "level"), [(0.2, 25), (0.45, 35)])
def test_bursts_have_their_share_and_level(share, level):
    """Noise that is hit too rarely would flatter the reader."""
    power = np.concatenate(
        [np.abs(block.reshape(-1)) ** 2 for block in added(begun(radio.Bursts(share, level)))]
    )
    assert np.mean(power > 0) == pytest.approx(share, rel=0.1)
    assert 10 * np.log10(power[power > 0].mean() / NOISE**2) == pytest.approx(level, abs=0.1)
    starts = np.count_nonzero(np.diff((power > 0).astype(int)) == 1)
    assert np.count_nonzero(power) / starts / RATE == pytest.approx(1.15e-3, rel=0.15)


def test_clock_has_stated_duty_delay_rise_and_jitter():
    """Switches that differ from what is stated would be estimated as something else."""
    switches = effects.Switches(
        1000.0, offset_ppm=700.0, duty=(0.2485, 0.2510), delay_s=1e-6, rise_s=0.5e-6
    )
    air = effects.Air(LINE, NOISE, frame(), FRAMES)
    switches.begin(air, np.random.default_rng(1))
    assert switches.cycles[-1] == pytest.approx(FRAMES * FRAME / RATE * 1000.7, abs=1e-6)
    switches.cycles = np.arange(FRAMES + 1) * 0.618034  # samples at all positions of a cycle
    first, second = switches.on(0, FRAMES)
    assert first.mean() == pytest.approx(0.2485, abs=2e-4)
    assert second.mean() == pytest.approx(0.2510, abs=2e-4)
    cycles = effects.within_frames(switches.cycles, 0, FRAMES).reshape(-1) % 1
    pulse = (cycles > 0.1) & (cycles < 0.4)
    centre = np.average(cycles[pulse], weights=second.reshape(-1)[pulse])
    assert centre - 0.25 == pytest.approx(1e-3, abs=1e-5)
    assert np.count_nonzero((first > 0) & (first < 1)) / first.size == pytest.approx(1e-3, rel=0.2)
    jittery = effects.Switches(1000.0, jitter_s=0.3e-6, wander_ppm=0.0)
    jittery.begin(effects.Air(LINE, NOISE, frame(), 60 * GROUP), np.random.default_rng(1))
    at_periods = np.interp(np.arange(2000.0) * 1e-3, air_times(60 * GROUP), jittery.cycles)
    assert np.std(np.diff(at_periods)) * 1e-3 == pytest.approx(0.3e-6, rel=0.1)


def air_times(frames):
    return np.arange(frames + 1) * FRAME / RATE


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
