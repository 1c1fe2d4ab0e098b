# SPDX-License-Identifier: GPL-3.0-or-later
"""The blocks of the textbook chain: stages of the receiver, wired one by one."""

import numpy as np
import pmt
import pytest
from chain_from_file import Chain
from chain_runs import (
    assert_equal_readings,
    press_fold,
    readings_of_chain,
    readings_of_reader,
    run_chain,
)
from device_times import rx_time, tag_at
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.blocks import names
from gnuradio.wiforce.blocks.group_block import state_from_pmt, state_to_pmt
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.receiver.recording_reader import RecordingReader
from plain import make_air
from press_capture import DEFAULT, FRAME, GROUP, RATE_HZ, SCENE, Run, array_source, run_flowgraph
from wiforce_app.bench.air import TagOnAir


def readings_of_receiver(plan, codes, lost, tracked):
    """Readings by NumPy alone, in double precision; ``lost`` samples are absent."""
    receiver = wiforce.Receiver(plan, tracked)
    frames = codes.astype(float).reshape(25, plan.group_length, FRAME, 2) / 32768
    used = frames[:, :, 64:320, 0] + 1j * frames[:, :, 64:320, 1]
    folded = used.reshape(25, plan.group_length, 4, 64).mean(axis=2)
    present = np.ones(len(codes), bool)
    present[lost] = False
    # A frame of which any sample is absent gives no snapshot.
    present = present.reshape(25, plan.group_length, FRAME).all(axis=2)
    factors, rotation = plan.waveform.equalizer(), plan.table.derotation(RATE_HZ)
    solved = [plan.table.for_present(mask).weights for mask in present]
    rows = [w @ group[mask] for w, group, mask in zip(solved, folded, present, strict=True)]
    tones = (np.fft.fft(np.array(rows) * rotation) * factors)[:, :, plan.waveform.bins]
    missing = np.sum(~present, axis=1)
    groups = Groups(np.arange(25), tones, missing, snapshot_weights=present)
    return receiver.process(groups) + receiver.finish()


LOST = slice(18 * GROUP + 25_000, 18 * GROUP + 34_000)


@pytest.mark.parametrize(
    "lost, tracked", [(slice(0), False), (LOST, True)], ids=["complete", "with a gap, tracked"]
)
def test_chain_blocks_reader_and_receiver_give_equal_readings(codes, plan, lost, tracked):
    kept, tags = np.delete(codes, lost, axis=0), []
    if lost.stop > (lost.start or 0):
        tags = [rx_time(0, 0.0), rx_time(lost.start, lost.stop / RATE_HZ)]
    expected = readings_of_receiver(plan, codes, lost, tracked)
    assert len(expected) == 25 and sum(r.touch == 1 for r in expected) >= 8
    for found in (
        readings_of_chain(plan, array_source(kept, tags), press_fold(), tracked=tracked),
        readings_of_reader(plan, array_source(kept, tags), tracked=tracked),
    ):
        # Single precision in the C++ blocks and between the Python ones.
        assert len(found) == 25
        for a, b in zip(found, expected, strict=True):
            assert (a.time_s, a.sensor, a.touch, a.flags) == (b.time_s, b.sensor, b.touch, b.flags)
            for name in ("phase1_deg", "phase2_deg"):
                assert getattr(a, name) == pytest.approx(getattr(b, name), abs=2e-3)
            if b.force_n is not None:
                assert a.force_n == pytest.approx(b.force_n, abs=0.04 * b.force_std_n)
                assert a.location_mm == pytest.approx(b.location_mm, abs=0.04 * b.location_std_mm)


@pytest.mark.parametrize("estimator", ["paper", "sideband"])
def test_chain_ratios_of_other_estimators_are_read_as_changes(codes, estimator):
    """Steps from group to group, and squares: a press would be read in its first group only."""
    plan = wiforce.plan(SCENE, estimator=estimator)
    expected = readings_of_receiver(plan, codes, slice(0), False)
    found = readings_of_chain(plan, array_source(codes), press_fold())
    assert [r.flags for r in found] == [r.flags for r in expected]
    phases = [[(r.phase1_deg, r.phase2_deg) for r in rows] for rows in (found, expected)]
    np.testing.assert_allclose(*np.array(phases, float), atol=2e-3)


# What the survey adapts the plan to: lamps, and a receiver that compresses.
ROOMS = {
    "lamps": {
        "radio": {"sample_rate_hz": 2.5e6},
        "sounding": {"frame_length": 400},
        "phase_group": {"snapshots": 200},
        "sensors": [{"name": "arm", "model": "line-900mhz", "clock_hz": 440}],
        "simulation": SCENE["simulation"] | {"lamps": {"mains_hz": 50, "level_db": 0}},
    },
    "compression": {
        "radio": {"sample_rate_hz": 6.25e6},
        "phase_group": {"snapshots": 300},
        "simulation": SCENE["simulation"] | {"front_end": {"compression": 0.01}},
    },
}


@pytest.mark.parametrize("room", ROOMS)
def test_chain_with_the_plan_for_a_capture_reads_as_the_recording_reader(tmp_path, room):
    """The blocks do not survey the room: with the scene's own plan they read it otherwise."""
    scene = wiforce.load_scene(DEFAULT | ROOMS[room])
    wiforce.simulate(scene, tmp_path / "press")
    capture = open_capture(tmp_path / "press")
    expected = [reading for batch in RecordingReader(capture, scene) for reading in batch]
    found, unadapted = (
        readings_of_chain(used, wiforce.capture_source(capture, scene))
        for used in (wiforce.plan_for_capture(capture, scene), wiforce.plan(scene))
    )
    assert sum(reading.touch == 1 for reading in expected) >= 8
    assert_equal_readings(found, expected)
    changed = [abs(a.phase2_deg - b.phase2_deg) for a, b in zip(found, unadapted, strict=True)]
    assert max(changed) > 0.1


def test_chain_of_two_sensors_reads_as_the_reader(tmp_path):
    scene = wiforce.load_scene("tabletop_two").as_dict()
    scene["simulation"] |= {"duration_s": 2.4}
    wiforce.simulate(scene, tmp_path / "presses")
    scene = wiforce.load_scene(scene)
    capture = open_capture(tmp_path / "presses")
    expected = readings_of_reader(
        scene, wiforce.capture_source(capture, scene), input_type="folded"
    )
    assert {reading.sensor for reading in expected if reading.touch} == {"left", "right"}
    found = readings_of_chain(wiforce.plan(scene), wiforce.capture_source(capture, scene))
    assert_equal_readings(found, expected)


def test_chain_gap_without_its_message_affects_only_its_group(codes, plan):
    tags = [rx_time(0, 0.0), rx_time(LOST.start, LOST.stop / RATE_HZ)]
    source = array_source(np.delete(codes, LOST, axis=0), tags)
    readings = []
    chain = Chain(plan, readings.append)
    run_flowgraph(source, press_fold(), chain.tones, chain.channel, *chain.to_force)
    chain.check()
    assert [r.touch for r in readings[16:21]] == [1, 1, None, 1, 1]
    assert readings[18].flags == ("gap",) and readings[18].force_n is None


def test_chain_block_invalid_message_ends_the_flowgraph(plan):
    separation = wiforce.end_separation(plan)
    separation.to_basic_block()._post(pmt.intern(names.INCOMPLETE), pmt.PMT_T)
    rows = len(plan.table.tones)
    Run(array_source(np.zeros((3, 64 * rows), np.complex64), group_tags(3)), separation)
    assert separation.failure is not None


def group_tags(count):
    """Tags of consecutive groups, as the Doppler block sets them."""
    return [tag_at(group, names.GROUP, pmt.from_uint64(group)) for group in range(count)]


def test_chain_blocks_unoccupied_bins_are_neither_read_nor_sent():
    """Nobody sends on them: what arrives there is an interferer, or no number at all."""
    plan = wiforce.plan(DEFAULT)
    count, occupied = 20, np.isin(np.arange(64), plan.waveform.bins)
    air = make_air(plan.group_length, [TagOnAir(untouched_deg=(35.0, -80.0))], 26, 20.0)
    tones = np.full((count, len(plan.table.tones), 64), np.nan, np.complex64)
    tones[:, :, occupied] = [plan.table.weights @ air.group(g) for g in range(count)]
    for later in ([], [wiforce.conjugate_difference(plan)]):
        chain = [wiforce.end_separation(plan, derotated=False), *later]
        source = array_source(tones.reshape(count, -1), group_tags(count))
        vectors = Run(source, *chain).items.reshape(count, 2, 64)
        assert np.all(vectors[:, :, ~occupied] == 0)
        assert np.all(np.isfinite(vectors)) and np.all(vectors[:, :, occupied] != 0)


@pytest.mark.parametrize(
    "make", [wiforce.conjugate_difference, wiforce.subcarrier_average, wiforce.force_inversion]
)
def test_chain_block_without_the_blocks_before_it_ends_the_flowgraph(plan, make):
    block = make(plan)
    length = block.input_signature().sizeof_stream_item(0) // gr.sizeof_gr_complex
    chain = [array_source(np.zeros((3, length), np.complex64)), block]
    if block.output_signature().max_streams():
        size = block.output_signature().sizeof_stream_item(0)
        chain.append(blocks.null_sink(size))
    run_flowgraph(*chain)
    assert isinstance(block.failure, RuntimeError)
    assert "connect after end_separation" in str(block.failure)


class Mean(gr.sync_block):
    """A block of a user's own in place of Subcarrier Average: the plain mean, no deviation."""

    def __init__(self):
        gr.sync_block.__init__(self, "mean", [(np.complex64, 128)], [(np.complex64, 2)])

    def work(self, input_items, output_items):
        output_items[0][:] = input_items[0].reshape(-1, 2, 64).mean(axis=2)
        return len(output_items[0])


def test_block_of_ones_own_is_told_what_the_next_one_needs(plan, codes):
    chain = Chain(plan, print)
    chain.to_force[2] = Mean()
    with pytest.raises(InputError, match="^tag state: must hold phase_std_deg, which Subcarrier"):
        run_chain(chain, array_source(codes), press_fold())


def separated(index, locked, offsets_ppm):
    """One group behind the separation."""
    return Groups(
        [index],
        locked=np.array([locked]),
        clock_offset_ppm=np.array([offsets_ppm]),
    )


def test_state_of_another_kind_is_refused_and_further_entries_are_ignored():
    state = state_to_pmt(separated(3, [True, False], [40.0, 0.0]))
    own = pmt.dict_add(state, pmt.make_dict(), pmt.PMT_T)  # which Python cannot hold
    assert state_from_pmt(own).clock_offset_ppm.tolist() == [[40.0, 0.0]]
    for value in (pmt.from_long(3), pmt.make_dict(), pmt.intern("state")):
        with pytest.raises(InputError, match="^tag state: must hold the state of a group"):
            state_from_pmt(value)


def test_clock_offset_without_lock_is_nan():
    groups = [separated(0, [True, False], [40.0, 0.0]), separated(1, [True, True], [41.5, -65.25])]
    tags = [tag_at(n, names.STATE, state_to_pmt(group)) for n, group in enumerate(groups)]
    source = blocks.vector_source_c([0j] * 3 * 256, False, 256, tags)
    block = wiforce.clock_offset(sensors=2, length=256)
    sink = blocks.vector_sink_f(2)
    run_flowgraph(source, block, sink)
    found = np.array(sink.data()).reshape(3, 2)
    np.testing.assert_array_equal(found, [[40, np.nan], [41.5, -65.25], [np.nan, np.nan]])
