# SPDX-License-Identifier: GPL-3.0-or-later
"""Hierarchical block: received samples to readings, wired from a scene."""

import numpy as np
import pmt
from gnuradio import gr

from .. import names
from ..errors import InputError
from ..estimation.estimators import estimator_named
from ..io.samples import ITEM_TYPES
from ..planning.plan import plan as plan_of
from ..scene import Scene, load_scene
from ..wiforce_python import ofdm_channel_estimator, phase_group_doppler, preamble_fold
from .conjugate_difference import conjugate_difference
from .end_separation import end_separation
from .force_inversion import force_inversion
from .subcarrier_average import subcarrier_average

_ITEM_BYTES = {
    **{name: kind.sample_bytes for name, kind in ITEM_TYPES.items()},
    "folded": 64 * gr.sizeof_gr_complex,
}


class reader(gr.hier_block2):
    """Reads force and location from received samples.

    Message port ``readings`` (out): a dict per group and sensor (see ``force_inversion``).
    Message port ``tare`` (in): take the untouched reference anew.

    The inner blocks are attributes (``estimator``, ``separation``, ``difference``, ``average``,
    ``inversion``) for who wants to tap their streams. Before them comes ``fold``, which takes the
    tones of samples in one thread, or, for folded vectors, ``doppler``; the other is None.

    Parameters
    ----------
    scene : str, dict or Scene
        Scene file, or the scene itself.
    input_type : str
        ``fc32`` or ``sc16`` samples, or ``folded`` vectors from a ``recording_source``.
    frame_offset : int
        Samples before the first frame of the stream.
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    on_reading : callable, optional
        Called with every :class:`io.readings.Reading`.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, file and key, rule and value.
    """

    def __init__(self, scene, input_type="fc32", frame_offset=0, tracked=False, on_reading=None):
        if input_type not in _ITEM_BYTES:
            rule = f"must be one of {', '.join(_ITEM_BYTES)}"
            raise InputError("input_type", rule, input_type)
        if frame_offset < 0:
            raise InputError("frame_offset", "must be 0 or more", frame_offset)
        self.scene = scene if isinstance(scene, Scene) else load_scene(scene)
        if self.scene.environment.receive_antennas > 1 and input_type != "folded":
            rule = "must be 1 where samples come in; two antennas are folded, then antenna_ratio"
            raise InputError("environment.receive_antennas", rule, 2)
        self.plan = plan_of(self.scene)
        gr.hier_block2.__init__(
            self,
            "reader",
            gr.io_signature(1, 1, _ITEM_BYTES[input_type]),
            gr.io_signature(0, 0, 0),
        )
        self.message_port_register_hier_out(names.READINGS)
        self.message_port_register_hier_in(names.TARE)
        self._make_blocks(input_type, frame_offset, tracked, on_reading)
        first = self.doppler if self.fold is None else self.fold
        chain = [first, self.estimator, self.separation, self.difference]
        chain += [self.average, self.inversion]
        self.connect(self, *chain)
        self.msg_connect(first, names.INCOMPLETE, self.separation, names.INCOMPLETE)
        self.msg_connect(self.inversion, names.READINGS, self, names.READINGS)
        self.msg_connect(self, names.TARE, self.difference, names.TARE)

    def _make_blocks(self, input_type, frame_offset, tracked, on_reading):
        scene, settings = self.scene, self.plan
        waveform, table = settings.waveform, settings.table
        sensors = len(scene.sensors)
        self.fold = self.doppler = None
        if input_type == "folded":
            self.doppler = phase_group_doppler(
                weights=table.weights, group_length=settings.group_length
            )
        else:
            self.fold = preamble_fold.tones(
                weights=table.weights,
                group_length=settings.group_length,
                frame_length=waveform.frame_length,
                first_averaged=waveform.first_averaged,
                repetitions=waveform.repetitions,
                sample_rate=waveform.sample_rate_hz,
                frame_offset=frame_offset,
                item_type=input_type,
            )
        self.estimator = ofdm_channel_estimator(
            factors=waveform.equalizer().astype(np.complex64),
            rows=len(table.tones),
            rotation=table.derotation(waveform.sample_rate_hz).astype(np.complex64),
        )
        self.separation = end_separation(
            clocks_hz=[clock.clock_hz for clock in settings.clocks],
            group_length=settings.group_length,
            waveform=waveform.name,
            frame_length=waveform.frame_length,
            sample_rate=waveform.sample_rate_hz,
            clutter_hz=settings.clutter_hz,
            harmonics=settings.harmonics,
            tolerance_ppm=[clock.tolerance_ppm for clock in settings.clocks],
            estimator=settings.estimator,
        )
        self.difference = conjugate_difference(
            sensors=sensors,
            reference_groups=settings.reference_groups,
            against=estimator_named(settings.estimator).against,
            waveform=waveform.name,
        )
        self.average = subcarrier_average(
            sensors=sensors, smoothing_groups=settings.smoothing_groups, waveform=waveform.name
        )
        self.inversion = force_inversion(
            models=[sensor.load_model(scene) for sensor in scene.sensors],
            center_frequency=scene.radio.center_frequency_hz,
            group_period=settings.group_period_s,
            sensor_names=[sensor.name for sensor in scene.sensors],
            off_reflections=[np.asarray(sensor.off_reflection) for sensor in scene.sensors],
            tracked=tracked,
            ratios=estimator_named(settings.estimator).ratios,
            on_reading=on_reading,
        )

    @property
    def failure(self):
        """The exception that ended the flowgraph, None when all went well."""
        blocks = (self.separation, self.difference, self.average, self.inversion)
        return next((b.failure for b in blocks if b.failure is not None), None)

    @property
    def counts(self):
        """Groups by what became of them: a :class:`io.readings.GroupCounts`."""
        return self.inversion.counts

    def finish(self):
        """Reads the groups that the chain still holds back; for use when the flowgraph has ended.

        A stream that ends before the clocks are acquired or the reference is complete leaves
        its groups in ``separation`` and ``difference``.
        """
        if self.failure is not None:
            return
        for state, vectors in self.separation.flush():
            self._finish_from_difference(self.difference.difference.process(state, vectors))
        self._finish_from_difference(self.difference.difference.flush())
        self.inversion.finish()

    def _finish_from_difference(self, groups):
        for state, vectors in groups:
            self.inversion.read(*self.average.average.process(state, vectors))

    def tare(self):
        """Takes the untouched reference anew from the groups that follow."""
        self.difference.to_basic_block()._post(pmt.intern(names.TARE), pmt.PMT_T)
