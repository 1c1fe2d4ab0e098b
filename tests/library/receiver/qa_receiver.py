# SPDX-License-Identifier: GPL-3.0-or-later
"""The receiver: readings do not depend on how groups are divided into batches."""

import threading

import numpy as np
import pytest
from chain_runs import assert_equal_readings
from gnuradio import wiforce
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.receiver import Receiver, recording_reader
from gnuradio.wiforce.wiforce_kernels import end_separation
from plain import make_air
from wiforce_app.bench.air import TagOnAir

CLOCKS_HZ = (1000.0, 1400.0)
FORCE_N, LOCATIONS_MM = 4.0, (35.0, 55.0)


def make_plan(sensors=1, snapshots=625, estimator="harmonic"):
    scene = {
        "sensors": [
            {"name": f"s{i}", "model": "line-900mhz", "clock_hz": CLOCKS_HZ[i]}
            for i in range(sensors)
        ],
    }
    return wiforce.plan(scene, snapshots, estimator)


def recorded_groups(plan, count, untouched=(), **faults):
    """Groups of tones, pressed in all but the reference and ``untouched``.

    ``incomplete`` maps an index to the mask of its snapshots; ``saturated``, ``retuned`` and
    ``absent`` are indices.
    """
    carrier_hz, tags = plan.center_frequency_hz, []
    for i, sensor in enumerate(plan.sensors):
        touched = sensor.model.phases_deg(FORCE_N, LOCATIONS_MM[i], carrier_hz)
        free = sensor.model.untouched_deg(carrier_hz)
        tags.append(
            TagOnAir(
                plan.clocks[i].clock_hz,
                offset_ppm=40.0 - 90.0 * i,
                drift_ppm_per_s=0.3,
                start_cycles=0.3,
                untouched_deg=tuple(free),
                touched_deg=tuple(touched),
            )
        )
    air = make_air(plan.group_length, tags, 1, 25.0, static_db=40)
    incomplete = faults.get("incomplete", {})
    rows = []
    for g in range(count):
        snapshots = air.group(g, g >= plan.reference_groups and g not in untouched)
        if g in faults.get("absent", ()):
            continue
        present = incomplete.get(g, np.ones(plan.group_length, bool))
        table = plan.table if present.all() else plan.table.for_present(present)
        tones = table.weights @ snapshots[present]
        rows.append(
            Groups(
                [g],
                tones[None],
                np.array([np.sum(~present)]),
                np.array([g in faults.get("saturated", ())]),
                np.array([g in faults.get("retuned", ())]),
                None if present.all() else present[None],
            )
        )
    return Groups.concatenate(rows)


def readings_of(plan, groups, size, tare_at=None, tracked=False):
    """Readings of groups in batches of ``size``, None for one, with a tare before an index."""
    receiver = Receiver(plan, tracked, derotated=False)
    parts = [groups]
    if tare_at is not None:
        parts = [groups[groups.index < tare_at], groups[groups.index >= tare_at]]
    readings = []
    for i, part in enumerate(parts):
        if i:
            receiver.tare(force=True)
        step = size or len(part)
        for start in range(0, len(part), step):
            readings += receiver.process(part[start : start + step])
    return readings + receiver.finish()


def faulty_groups(plan):
    """A run with everything that may happen to a group, and the index of its tare.

    The press ends four groups before the tare, whose reference is as long as the first one.
    """
    rng = np.random.default_rng(2)
    masks = rng.random((3, plan.group_length)) > 0.2
    start = plan.reference_groups + 3
    groups = recorded_groups(
        plan,
        start + start + 31,
        untouched=range(start + 22, start + start + 25),
        incomplete={3: masks[0], start + 2: masks[1], start + 3: masks[2]},
        absent=(5, start + 6, start + 7),
        saturated=(start + 10,),
        retuned=(start + 20,),
    )
    return groups, start + 26


@pytest.fixture(scope="module", params=[(1, 625), (2, 125)], ids=str)
def run(request):
    """Plan, groups with faults, the index of a tare, and the readings of groups one by one."""
    plan = make_plan(*request.param)
    groups, tare_at = faulty_groups(plan)
    return plan, groups, tare_at, readings_of(plan, groups, 1, tare_at)


def test_receiver_batches_of_any_size_give_equal_readings(run):
    plan, groups, tare_at, expected = run
    for size in (7, None):
        assert_equal_readings(readings_of(plan, groups, size, tare_at), expected, 1e-6)


@pytest.mark.parametrize(
    ("settings", "tracked"),
    [({}, True), ({"estimator": "paper"}, False), ({"estimator": "sideband"}, False)],
)
def test_receiver_other_estimators_do_not_depend_on_the_batches(settings, tracked):
    plan = make_plan(**settings)
    groups, tare_at = faulty_groups(plan)
    expected = readings_of(plan, groups, 1, tare_at, tracked=tracked)
    assert_equal_readings(readings_of(plan, groups, None, tare_at, tracked=tracked), expected, 1e-6)


@pytest.mark.parametrize("sensors, snapshots, share", [(1, 625, 0.08), (2, 125, 0.03)])
def test_receiver_noise_that_changes_in_a_batch_does_not_depend_on_the_batches(
    sensors, snapshots, share, monkeypatch
):
    """The clocks are tracked by the new noise from the same group on."""
    plan = make_plan(sensors, snapshots)
    groups = recorded_groups(plan, 130)
    rng = np.random.default_rng(4)
    noise = rng.standard_normal((*groups.tones.shape, 2)) @ (1, 1j)
    level = np.std(groups.tones[1:] - groups.tones[:-1], axis=(0, 2))[:, None]
    groups.tones[60:] += share * level * noise[60:]
    groups.tones[97:] += 2 * level * noise[97:]
    seen, process = set(), end_separation.process

    def note(kernel, tags, weights, *arguments):
        found = process(kernel, tags, weights, *arguments)
        if len(found["gain"]) < len(weights):
            seen.add(found["lost"])
        return found

    monkeypatch.setattr(end_separation, "process", note)
    expected = readings_of(plan, groups, 1)
    for size in (7, None):
        assert_equal_readings(readings_of(plan, groups, size), expected, 1e-6)
    assert seen == {False, True}  # a step of the noise, and a lost model


@pytest.mark.parametrize("tare_at", [4, 12])
def test_receiver_tare_while_groups_are_held_back_does_not_depend_on_the_batches(tare_at):
    """During the acquisition of the clocks, and while the reference is taken."""
    plan = make_plan()
    groups = recorded_groups(plan, 40, untouched=range(30))
    expected = readings_of(plan, groups, 1, tare_at)
    assert len(expected) == 40
    assert_equal_readings(readings_of(plan, groups, 7, tare_at), expected, 1e-6)
    assert_equal_readings(readings_of(plan, groups, None, tare_at), expected, 1e-6)


def test_receiver_every_fault_is_flagged_where_it_is(run):
    """What the comparison of batches rests on: the run holds what it is said to hold."""
    plan, groups, tare_at, readings = run
    sensors, start = len(plan.sensors), plan.reference_groups + 3
    first = readings[::sensors]
    # smoothing only where groups are short
    assert plan.smoothing_groups == (5 if plan.group_length == 125 else 1)
    assert len(readings) == sensors * (start + start + 31)
    flagged = {
        flag: [i for i, r in enumerate(first) if flag in r.flags]
        for flag in ("gap", "saturated", "moved", "reference")
    }
    assert flagged["gap"] == [3, 5, start + 2, start + 3, start + 6, start + 7]
    assert flagged["saturated"] == [start + 10]
    renewed = tare_at + plan.reference_groups
    assert flagged["moved"] == list(range(start + 20, renewed))
    assert first[start + 6].phase1_deg is None and first[start + 2].phase1_deg is not None
    untouched = [i for i in range(plan.reference_groups) if i != 5]
    assert flagged["reference"] == [*untouched, *range(tare_at, renewed)]


@pytest.mark.parametrize("count", [0, 1, 5, 12, 20])
def test_receiver_finish_gives_what_is_held_back(count):
    """Runs that end before the clocks or the reference are known lose no group."""
    plan = make_plan()
    groups = recorded_groups(plan, 20)[:count]
    receiver = Receiver(plan, derotated=False)
    ready = receiver.process(groups) if count else []
    assert len(ready) == (19 if count == 20 else 0)
    times = [r.time_s for r in ready + receiver.finish()]
    assert times == pytest.approx((np.arange(count) + 0.5) * plan.group_period_s)
    assert receiver.finish() == []
    assert receiver.counts.groups == count


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"tones": None}, r"groups.tones: must have shape .*, got \(\)"),
        ({"tones": np.zeros((3, 5, 62))}, "groups.tones: must have shape"),
        ({"tones": np.zeros((2, 24, 62))}, "groups.tones: must have shape"),
        ({"tones": np.zeros((3, 24, 52))}, "groups.tones: must have shape"),
        ({"snapshot_weights": np.ones((3, 7))}, "groups.snapshot_weights: must have shape"),
        ({"index": np.array([2, 1, 0])}, "groups.index: must rise"),
    ],
)
def test_receiver_batch_of_another_shape_is_refused(change, message):
    """Arrays of another plan would broadcast, and give readings without meaning."""
    plan = make_plan()
    groups = recorded_groups(plan, 3).having(**change)
    with pytest.raises(InputError, match=message):
        Receiver(plan, derotated=False).process(groups)


def test_receiver_batch_that_steps_back_is_refused():
    """Its groups would be taken for those that another receiver has read, and be lost."""
    plan = make_plan()
    groups, receiver = recorded_groups(plan, 6), Receiver(plan, derotated=False)
    receiver.process(groups[:4])
    with pytest.raises(InputError, match=r"groups.index: must rise .* from 3 on"):
        receiver.process(groups[3:])
    receiver.process(groups[4:])


def test_receiver_press_of_one_sensor_is_no_force_of_another(tmp_path):
    """In the group in which a tag changes, part of it lies on the lines of the others."""
    scene = wiforce.load_scene("tabletop_two").as_dict()
    held = {"sensor": "right", "start_s": 0.8, "rise_s": 0.05, "hold_s": 5.2, "location_mm": 52.0}
    taps = [
        {"sensor": "left", "start_s": 1.2 + 0.515 * k, "rise_s": 0.1, "hold_s": 0.15}
        | {"force_n": 3.0, "location_mm": 33.0}
        for k in range(9)
    ]
    scene["simulation"] |= {
        "duration_s": 6.0,
        "seed": 7,
        "presses": [held | {"force_n": 5.0}, *taps],
    }
    wiforce.simulate(scene, tmp_path / "two")
    found = wiforce.read(tmp_path / "two")
    right = found[(found["sensor"] == "right") & (found["touch"] == 1) & found["ok"]]
    apart = (right["force_n"] - 5.0).abs()
    assert len(right) > 105 and (apart < 4 * right["force_std_n"]).all() and apart.max() < 0.8


def test_recording_reader_that_is_refused_folds_nothing_more(tmp_path, monkeypatch):
    """A program that goes on with another scene would share its cores with the one refused."""
    scene = wiforce.load_scene("tabletop").as_dict()
    wiforce.simulate(scene, tmp_path / "wide")
    scene["sensors"][0]["clock_tolerance_ppm"] = 20_000
    monkeypatch.setattr(recording_reader, "survey_recording", lambda *_: None)
    with pytest.raises(InputError, match="clock_tolerance_ppm"):
        recording_reader.RecordingReader(open_capture(tmp_path / "wide"), scene)
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("tones")]


def test_receiver_times_count_from_the_first_sample_also_of_lost_groups_and_tares():
    """Rows of lost groups would stand among those of others."""
    plan = wiforce.plan("surface_four_strips").with_first_frame(3_125_000)
    receiver = Receiver(plan)
    start_s = 3_125_000 / plan.waveform.sample_rate_hz
    times = {each.time_s for each in receiver.finish(1)}
    assert times == {start_s + plan.group_period_s / 2}
    assert receiver.tare().time_s == pytest.approx(start_s)
