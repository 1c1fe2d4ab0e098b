# SPDX-License-Identifier: GPL-3.0-or-later
"""What each step of a plan costs on this machine: processor time per second of signal.

GNU Radio's performance counters time the blocks over a simulated press. What a skip saves is what
the same blocks take with the step forced on, less what they take without.
"""

import dataclasses
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from gnuradio.wiforce.estimation.average import AdaptiveAverage
from gnuradio.wiforce.scene.plan import HARMONICS
from gnuradio.wiforce.scene.schema import Press
from gnuradio.wiforce.scene.simulator import simulate
from gnuradio.wiforce.scene.steps import steps

# Signal behind the untouched reference: long enough that a block's start does not count.
_PRESSED_S = 1.0
_REPEATS = 20


def measure_steps(scene, plan):
    """Processor time of each step, or what its skip saves.

    Parameters
    ----------
    scene : Scene
    plan : Plan

    Returns
    -------
    dict
        Name of the step (see ``scene.steps``) to seconds per second of signal.
    """
    # Read by GNU Radio when it is imported.
    os.environ["GR_CONF_PERFCOUNTERS_ON"] = "True"
    os.environ["GR_CONF_PERFCOUNTERS_CLOCK"] = "thread"
    scene = _pressed(scene)
    with tempfile.TemporaryDirectory(prefix="gr-wiforce-") as folder:
        capture = Path(folder) / "capture"
        simulate(scene, capture)
        samples = Path(f"{capture}.sigmf-data")
        signal_s = samples.stat().st_size / 4 / scene.radio.sample_rate_hz
        chain = _Chain(samples, plan)
        took = {**_reader_times(samples, scene), **chain.plain()}
        took["guard and first repetition"] = chain.whole_frames() - took["preamble_fold"]
        per_snapshot = chain.channel_first() - took["ofdm_channel_estimator"]
        took["channel per snapshot"] = per_snapshot
        if any(step.name == "more lines" for step in steps(scene, plan)):
            took["more lines"] = chain.most_lines() - took["phase_group_doppler"]
    took = {name: seconds / signal_s for name, seconds in took.items()}
    took |= _group_skips(scene, plan)
    return {name: max(seconds, 0.0) for name, seconds in took.items()}


def _pressed(scene):
    """The scene with one long press on each sensor after the reference."""
    presses = []
    for sensor in scene.sensors:
        model = sensor.load_model(scene)
        force, place = np.mean(model.force_span_n), np.mean(model.location_span_mm)
        presses.append(Press(sensor.name, scene.reference_s, 0.0, 1e3, force, force, place))
    simulation = dataclasses.replace(
        scene.simulation,
        duration_s=scene.reference_s + max(_PRESSED_S, 12 * scene.group_period_s),
        presses=tuple(presses),
        moves=(),
    )
    return dataclasses.replace(scene, simulation=simulation)


def _reader_times(samples, scene):
    """The reader's blocks behind its first, over the whole recording."""
    from gnuradio import blocks, gr, wiforce

    flowgraph = gr.top_block()
    reader = wiforce.reader(scene, input_type="sc16")
    flowgraph.connect(blocks.file_source(4, str(samples)), reader)
    flowgraph.run()
    steps = {
        "ofdm_channel_estimator": reader.estimator,
        "end_separation": reader.separation,
        "conjugate_difference": reader.difference,
        "subcarrier_average": reader.average,
        "force_inversion": reader.inversion,
    }
    return {name: _seconds(block) for name, block in steps.items()}


def _seconds(block):
    return 1e-9 * block.pc_work_time_total()


class _Chain:
    """The blocks from samples to tones, in the order and with the settings that are asked for."""

    def __init__(self, samples, plan):
        self._samples, self._plan = str(samples), plan

    def plain(self):
        fold, doppler = self._fold(), self._doppler(self._plan)
        self._run(fold, doppler)
        return {"preamble_fold": _seconds(fold), "phase_group_doppler": _seconds(doppler)}

    def whole_frames(self):
        """Folding with every sample of a frame looked at."""
        frame = self._plan.waveform.frame_length
        fold = self._fold(first_averaged=0, repetitions=frame // 64)
        self._run(fold)
        return _seconds(fold)

    def channel_first(self):
        """The channel estimate of every snapshot, before the tones."""
        from gnuradio import wiforce

        estimator = wiforce.ofdm_channel_estimator(self._plan.waveform.equalizer(), 1)
        self._run(self._fold(), estimator, self._doppler(self._plan))
        return _seconds(estimator)

    def most_lines(self):
        doppler = self._doppler(dataclasses.replace(self._plan, harmonics=HARMONICS[-1]))
        self._run(self._fold(), doppler)
        return _seconds(doppler)

    def _fold(self, first_averaged=None, repetitions=None):
        from gnuradio import wiforce

        waveform = self._plan.waveform
        return wiforce.preamble_fold(
            waveform.frame_length,
            waveform.first_averaged if first_averaged is None else first_averaged,
            repetitions or waveform.repetitions,
            item_type="sc16",
        )

    def _doppler(self, plan):
        from gnuradio import wiforce

        return wiforce.phase_group_doppler(plan.table.weights, plan.group_length)

    def _run(self, *chain):
        from gnuradio import blocks, gr

        flowgraph = gr.top_block()
        item = chain[-1].output_signature().sizeof_stream_item(0)
        source = blocks.file_source(4, self._samples)
        flowgraph.connect(source, *chain, blocks.null_sink(item))
        flowgraph.run()


def _group_skips(scene, plan):
    """What is not done once per group: averaging over a single group, inverting untouched ones."""
    rate, sensors = 1 / plan.group_period_s, len(scene.sensors)
    took = {}
    if plan.smoothing_groups == 1:
        average, ratio = AdaptiveAverage(1), np.ones(2, complex)
        took["average over groups"] = _each(lambda: average.update(ratio, np.ones(2))) * sensors
    carrier_hz, inversion = scene.radio.center_frequency_hz, 0.0
    for sensor in scene.sensors:
        model = sensor.load_model(scene)
        phases = np.array([model.untouched_deg(carrier_hz)])
        model.inverter(carrier_hz).prepare()
        inversion += _each(lambda m=model, p=phases: m.invert(p, 1.0, frequency_hz=carrier_hz))
    took["inversion while untouched"] = inversion
    return {name: seconds * rate for name, seconds in took.items()}


def _each(call):
    """Processor time of one call; the least of some, after one that warms up."""
    call()
    times = []
    for _ in range(_REPEATS):
        start = time.thread_time()
        call()
        times.append(time.thread_time() - start)
    return min(times)
