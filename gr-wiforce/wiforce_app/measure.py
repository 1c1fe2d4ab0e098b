# SPDX-License-Identifier: GPL-3.0-or-later
"""Measures the cost of each step of a plan, as processor time per second of signal.

GNU Radio's performance counters time the C++ blocks over a simulated press, and the receiver's
stages are timed on the tones that come out. Folding and tones are one block here, so the cost of
the tones is what they add to folding alone; streams compute them by the same kernel. The saving of
a skipped step is the time of the same block with the step forced on, minus its time without.
"""

import dataclasses
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from gnuradio.wiforce.estimation.average import AdaptiveAverage
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.planning.plan import HARMONICS
from gnuradio.wiforce.planning.plan import plan as plan_of
from gnuradio.wiforce.planning.steps import steps
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.scene import Press
from gnuradio.wiforce.signal.waveform import FFT_LENGTH
from gnuradio.wiforce.simulation.simulator import simulate

# Signal after the untouched reference: long enough that a block's start-up is negligible.
_PRESSED_S = 1.0
_REPEATS, _RUNS = 20, 3
_BATCH = 64  # groups


def measure_steps(plan):
    """Processor time of each step, or the saving when it is skipped.

    Parameters
    ----------
    plan : Plan
        Of a scene.

    Returns
    -------
    dict
        Name of the step (see ``planning.steps``) to seconds per second of signal.
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
        chain = _Chain(samples, plan)
        took, tones = _receiver_times(samples, plan_of(scene)), chain.tones()
        took["fold"] = chain.fold()
        took["tones"] = tones - took["fold"]
        took["guard and first repetition"] = chain.whole_frames() - tones
        per_snapshot = chain.channel_first() - took["channel"]
        took["channel per snapshot"] = per_snapshot
        if any(step.name == "more lines" for step in steps(plan)):
            took["more lines"] = chain.most_lines() - tones
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


def _receiver_times(samples, plan):
    """The channel estimator, and the receiver's stages, over the whole recording."""
    from gnuradio import blocks, gr, wiforce

    flowgraph = gr.top_block()
    waveform, rows = plan.waveform, len(plan.table.tones)
    fold = wiforce.preamble_fold.tones(
        plan.table.weights, plan.group_length, **waveform.folding, item_type="sc16"
    )
    rotation = plan.table.derotation(waveform.sample_rate_hz)
    estimator = wiforce.ofdm_channel_estimator(waveform.equalizer(), rows, rotation)
    sink = blocks.vector_sink_c(rows * FFT_LENGTH)
    flowgraph.connect(blocks.file_source(4, str(samples)), fold, estimator, sink)
    flowgraph.run()
    tones = np.array(sink.data(), np.complex64).reshape(-1, rows, FFT_LENGTH)
    took = _stage_times(plan, tones[:, :, waveform.bins])
    return took | {"channel": _seconds(estimator)}


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


class _Chain:
    """The blocks from samples to tones, in a given order and with given settings."""

    def __init__(self, samples, plan):
        self._samples, self._plan = str(samples), plan

    def tones(self):
        return self._time(lambda: self._tones(self._plan))

    def fold(self):
        return self._time(self._fold)

    def whole_frames(self):
        """With all samples of a frame folded."""
        whole = {
            "first_averaged": 0,
            "repetitions": self._plan.waveform.frame_length // FFT_LENGTH,
        }
        return self._time(lambda: self._tones(self._plan, **whole))

    def most_lines(self):
        most = dataclasses.replace(self._plan, harmonics=HARMONICS[-1])
        return self._time(lambda: self._tones(most))

    def channel_first(self):
        """The channel estimate of every snapshot, before the tones."""
        from gnuradio import wiforce

        factors = self._plan.waveform.equalizer()
        return self._time(lambda: wiforce.ofdm_channel_estimator(factors, 1), behind=self._fold)

    def _fold(self):
        from gnuradio import wiforce

        return wiforce.preamble_fold(**self._plan.waveform.folding, item_type="sc16")

    def _tones(self, plan, **frame):
        from gnuradio import wiforce

        return wiforce.preamble_fold.tones(
            plan.table.weights,
            plan.group_length,
            **self._plan.waveform.folding | frame,
            item_type="sc16",
        )

    def _time(self, make, behind=None):
        """The shortest time of a block in several runs, each with new blocks."""
        return min(self._run(make(), behind and behind()) for _ in range(_RUNS))

    def _run(self, block, behind):
        from gnuradio import blocks, gr

        flowgraph = gr.top_block()
        item = block.output_signature().sizeof_stream_item(0)
        chain = [blocks.file_source(4, self._samples), behind, block, blocks.null_sink(item)]
        flowgraph.connect(*filter(None, chain))
        flowgraph.run()
        return _seconds(block)


def _group_skips(plan):
    """Savings per group: averaging over a single group, inverting untouched groups."""
    rate, sensors = 1 / plan.group_period_s, len(plan.sensors)
    took = {}
    if plan.smoothing_groups == 1:
        average, ratio = AdaptiveAverage(1), np.ones(2, complex)
        took["average over groups"] = _each(lambda: average.update(ratio, np.ones(2))) * sensors
    carrier_hz, inversion = plan.center_frequency_hz, 0.0
    for sensor in plan.sensors:
        model = sensor.model
        phases = np.array([model.untouched_deg(carrier_hz)])
        model.inverter(carrier_hz)  # its table is not part of what a group costs
        inversion += _each(lambda m=model, p=phases: m.invert(p, 1.0, frequency_hz=carrier_hz))
    took["inversion while untouched"] = inversion
    return {name: seconds * rate for name, seconds in took.items()}


def _each(call):
    """Processor time of one call: the shortest of several, after one to warm up."""
    call()
    times = []
    for _ in range(_REPEATS):
        start = time.thread_time()
        call()
        times.append(time.thread_time() - start)
    return min(times)
