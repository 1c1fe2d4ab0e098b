# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the cost of each step of a plan, as processor time per second of signal.

A simulated press takes the path of the block Reader. GNU Radio's performance counters time the
block that folds samples and collects the snapshots of each group; tones and the receiver's stages
are timed on these snapshots. One kernel computes tones and channel, so the cost of the tones is its
time without that of the channel estimator, which exists as a block. The saving of a skipped step is
the time of the same computation with the step forced on, minus its time without.
"""

import dataclasses
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from gnuradio.wiforce.estimation.capture.folded_groups import FoldedGroups
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.planning.plan import plan as plan_of
from gnuradio.wiforce.planning.steps import MORE_LINES, with_more_lines
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.scene import Press
from gnuradio.wiforce.simulation.simulator import simulate

# Signal after the untouched reference: long enough that a block's start-up is negligible.
_PRESSED_S = 1.0
_REPEATS, _RUNS = 20, 3
_BATCH = 64  # groups


def measure_steps(plan):
    """Processor time of each step, or the saving when it is skipped.

    Returns dict: name of the step (see ``planning.steps``) to seconds per second of signal.
    """
    # Read by GNU Radio when it is imported.
    os.environ["GR_CONF_PERFCOUNTERS_ON"] = "True"
    os.environ["GR_CONF_PERFCOUNTERS_CLOCK"] = "thread"
    scene = _pressed(plan.require_scene())
    with tempfile.TemporaryDirectory(prefix="gr-wiforce-") as folder:
        capture = Path(folder) / "capture"
        simulate(scene, capture)
        samples = Path(f"{capture}.sigmf-data")
        signal_s = samples.stat().st_size / 4 / scene.radio.sample_rate_hz
        blocks = _Blocks(samples, plan)
        folded = blocks.snapshots()
        tones, transform = _transform(plan, folded)
        took = _stage_times(plan_of(scene), tones)
        took["fold"] = blocks.fold()
        took["channel"] = blocks.channel(tones)
        took["tones"] = transform - took["channel"]
        took["guard and first repetition"] = blocks.whole_frames() - took["fold"]
        took["channel per snapshot"] = blocks.channel_first() - took["channel"]
        if (more := with_more_lines(plan)) is not None:
            took[MORE_LINES] = _transform(more, folded)[1] - transform
    took = {name: seconds / signal_s for name, seconds in took.items()}
    took |= _group_skips(plan)
    return {name: max(seconds, 0.0) for name, seconds in took.items()}


def _pressed(scene):
    """The scene with one long press on each sensor after the reference, and one receive antenna."""
    presses = []
    for sensor in scene.sensors:
        model = sensor.load_model(scene)
        force, place = np.mean(model.force_span_n), np.mean(model.location_span_mm)
        presses.append(
            Press(
                sensor=sensor.name,
                start_s=scene.reference_s,
                rise_s=0.0,
                hold_s=1e3,
                force_n=force,
                end_force_n=force,
                location_mm=place,
            )
        )
    simulation = dataclasses.replace(
        scene.simulation,
        duration_s=scene.reference_s + max(_PRESSED_S, 12 * scene.group_period_s),
        presses=tuple(presses),
        moves=(),
    )
    environment = dataclasses.replace(scene.environment, receive_antennas=1)
    return dataclasses.replace(scene, simulation=simulation, environment=environment)


def _transform(plan, folded):
    """Tones (G, M, K) of the groups' snapshots (G, N, 64), and the time that they take."""
    kernel = FoldedGroups(plan.table, plan.waveform)
    present = np.ones(plan.group_length, bool)

    def transform():
        return np.array([kernel.solve(present, group)[0] for group in folded])

    return transform(), _each(transform)


def _stage_times(plan, tones):
    receiver = Receiver(plan)
    took = dict.fromkeys(("separation", "reference", "average", "readout"), 0.0)
    for first in range(0, len(tones), _BATCH):
        batch = tones[first : first + _BATCH]
        groups = Groups(first + np.arange(len(batch)), batch)
        for name in took:
            start = time.thread_time()
            groups = getattr(receiver, name).process(groups)
            took[name] += time.thread_time() - start
    return took


def _seconds(block):
    return 1e-9 * block.pc_work_time_total()


class _Blocks:
    """The blocks from samples to the snapshots of groups, and those that could replace them."""

    def __init__(self, samples, plan):
        self._samples, self._plan = str(samples), plan

    def snapshots(self):
        """Snapshots (G, N, 64) of the recording's groups."""
        from gnuradio import blocks

        length = self._plan.group_length * self._plan.waveform.symbol_length
        sink = blocks.vector_sink_c(length)
        self._run(self._collected(), sink)
        return np.array(sink.data(), np.complex64).reshape(
            -1, self._plan.group_length, self._plan.waveform.symbol_length
        )

    def fold(self):
        return self._time(self._collected)

    def whole_frames(self):
        """With all samples of a frame folded."""
        repetitions = self._plan.waveform.frame_length // self._plan.waveform.symbol_length
        return self._time(lambda: self._collected(first_averaged=0, repetitions=repetitions))

    def channel(self, tones):
        """The channel estimate of all tones."""
        from gnuradio import blocks, gr

        rows = tones.shape[1]
        values = np.zeros((len(tones), rows, self._plan.waveform.symbol_length), np.complex64)
        values[:, :, self._plan.waveform.bins] = tones
        rotation = self._plan.table.derotation(
            self._plan.waveform.sample_rate_hz, self._plan.waveform.symbol_length
        )
        times = []
        for _ in range(_RUNS):
            estimator = self._estimator(rows, rotation)
            source = blocks.vector_source_c(
                values.ravel().tolist(), False, rows * self._plan.waveform.symbol_length
            )
            flowgraph = gr.top_block()
            flowgraph.connect(source, estimator, _null_sink(estimator))
            flowgraph.run()
            times.append(_seconds(estimator))
        return min(times)

    def channel_first(self):
        """The channel estimate of every snapshot, before the tones."""
        from gnuradio import wiforce

        folding = self._plan.waveform.folding
        return self._time(
            lambda: self._estimator(1), lambda: wiforce.preamble_fold(**folding, item_type="sc16")
        )

    def _collected(self, **frame):
        from gnuradio import wiforce

        folding = self._plan.waveform.folding | frame
        return wiforce.preamble_fold.collected(self._plan.group_length, **folding, item_type="sc16")

    def _estimator(self, rows, rotation=()):
        from gnuradio import wiforce

        return wiforce.ofdm_channel_estimator(self._plan.waveform.equalizer(), rows, rotation)

    def _time(self, make, make_before=None):
        """The shortest time of a block in several runs, each with new blocks."""
        times = []
        for _ in range(_RUNS):
            before, block = [make_before()] if make_before else [], make()
            self._run(*before, block, _null_sink(block))
            times.append(_seconds(block))
        return min(times)

    def _run(self, *chain):
        from gnuradio import blocks, gr

        flowgraph = gr.top_block()
        flowgraph.connect(blocks.file_source(4, self._samples), *chain)
        flowgraph.run()


def _null_sink(block):
    from gnuradio import blocks

    return blocks.null_sink(block.output_signature().sizeof_stream_item(0))


def _group_skips(plan):
    """Savings per group: inverting untouched groups."""
    rate = 1 / plan.group_period_s
    carrier_hz, inversion = plan.center_frequency_hz, 0.0
    for sensor in plan.sensors:
        model = sensor.model
        phases = np.array([model.untouched_deg(carrier_hz)])
        model.inverter(carrier_hz)  # its table is not part of what a group costs
        inversion += _each(lambda m=model, p=phases: m.invert(p, 1.0, frequency_hz=carrier_hz))
    return {"inversion while untouched": inversion * rate}


def _each(call):
    """Processor time of one call: the shortest of several, after one to warm up."""
    call()
    times = []
    for _ in range(_REPEATS):
        start = time.thread_time()
        call()
        times.append(time.thread_time() - start)
    return min(times)
