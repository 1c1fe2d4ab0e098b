# SPDX-License-Identifier: GPL-3.0-or-later
"""What each step of a plan costs on this machine: processor time per second of signal.

GNU Radio's performance counters time the reader's blocks over a simulated press. Folding and tones
are one block there: the tones' share is what they add to folding alone. What a skip saves is what
the same block takes with the step forced on, less what it takes without.
"""

import dataclasses
import os
import tempfile
import time
from pathlib import Path

import numpy as np
from gnuradio.wiforce.estimation.average import AdaptiveAverage
from gnuradio.wiforce.planning.plan import HARMONICS
from gnuradio.wiforce.planning.steps import steps
from gnuradio.wiforce.scene.schema import Press
from gnuradio.wiforce.signal.waveform import FFT_LENGTH
from gnuradio.wiforce.simulation.simulator import simulate

# Signal behind the untouched reference: long enough that a block's start does not count.
_PRESSED_S = 1.0
_REPEATS, _RUNS = 20, 3


def measure_steps(scene, plan):
    """Processor time of each step, or what its skip saves.

    Parameters
    ----------
    scene : Scene
    plan : Plan

    Returns
    -------
    dict
        Name of the step (see ``planning.steps``) to seconds per second of signal.
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
        took, tones = _reader_times(samples, scene), chain.tones()
        took["preamble_fold"] = chain.fold()
        took["phase_group_doppler"] = tones - took["preamble_fold"]
        took["guard and first repetition"] = chain.whole_frames() - tones
        per_snapshot = chain.channel_first() - took["ofdm_channel_estimator"]
        took["channel per snapshot"] = per_snapshot
        if any(step.name == "more lines" for step in steps(scene, plan)):
            took["more lines"] = chain.most_lines() - tones
    took = {name: seconds / signal_s for name, seconds in took.items()}
    took |= _group_skips(scene, plan)
    return {name: max(seconds, 0.0) for name, seconds in took.items()}


def _pressed(scene):
    """The scene with one long press on each sensor after the reference, heard by one antenna."""
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
    environment = dataclasses.replace(scene.environment, receive_antennas=1)
    return dataclasses.replace(scene, simulation=simulation, environment=environment)


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

    def tones(self):
        return self._time(lambda: self._tones(self._plan))

    def fold(self):
        return self._time(self._fold)

    def whole_frames(self):
        """Every sample of a frame looked at."""
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

        return wiforce.preamble_fold(**self._frame(), item_type="sc16")

    def _tones(self, plan, **frame):
        from gnuradio import wiforce

        return wiforce.preamble_fold.tones(
            plan.table.weights, plan.group_length, **self._frame() | frame, item_type="sc16"
        )

    def _frame(self):
        waveform = self._plan.waveform
        return {
            "frame_length": waveform.frame_length,
            "first_averaged": waveform.first_averaged,
            "repetitions": waveform.repetitions,
        }

    def _time(self, make, behind=None):
        """The least time that a block took in some runs, each with blocks of its own."""
        return min(self._run(make(), behind and behind()) for _ in range(_RUNS))

    def _run(self, block, behind):
        from gnuradio import blocks, gr

        flowgraph = gr.top_block()
        item = block.output_signature().sizeof_stream_item(0)
        chain = [blocks.file_source(4, self._samples), behind, block, blocks.null_sink(item)]
        flowgraph.connect(*filter(None, chain))
        flowgraph.run()
        return _seconds(block)


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
        model.inverter(carrier_hz)  # its table is not part of what a group costs
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
