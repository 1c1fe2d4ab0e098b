# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: tones of a group to the complex channels of the tags' ends."""

import numpy as np
import pmt

from . import names
from .errors import InputError
from .estimation.paper import PaperSeparator
from .estimation.separation import EndSeparator, TagClock
from .estimation.weights import design_weights
from .group_block import GroupBlock
from .waveform import sounding_waveform


def tone_weights(
    clocks_hz,
    group_length=625,
    frame_length=720,
    sample_rate=12.5e6,
    clutter_hz=0.0,
    harmonics=8,
):
    """Weight table for ``phase_group_doppler`` that suits ``end_separation`` of the same settings.

    Returns
    -------
    ndarray of complex64, shape (M, group_length)
    """
    period = frame_length / sample_rate
    table = design_weights(clocks_hz, group_length, period, clutter_hz, harmonics)
    return table.weights.astype(np.complex64)


class end_separation(GroupBlock):
    """Separates the ends of every tag in a group's tones, at the tracked clock.

    Input: vectors M x 64, the channel at each tone (``phase_group_doppler`` with
    ``tone_weights(...)``, then ``ofdm_channel_estimator``), tagged ``group`` and ``missing``.
    Output: vectors 2S x 64, V_i of each end with the clock taken out, tagged ``state``.
    Message port ``incomplete``: snapshots of groups with gaps, from ``phase_group_doppler``.

    Parameters
    ----------
    clocks_hz : sequence of float
        Nominal fs of each tag.
    group_length : int
        Snapshots per phase group.
    waveform : str
        ``repeated`` or ``wifi``.
    frame_length : int
        Samples per frame.
    sample_rate : float
        Samples per second.
    clutter_hz : float
        Highest Doppler frequency of anything that moves; 0 for a still scene.
    harmonics : int
        Lines +-1..+-harmonics of each tag are used; at least 4.
    tolerance_ppm : float or sequence of float
        How far each tag's clock may be off.
    estimator : str
        ``harmonic``, or ``paper``: lines +1 and +4 alone, clock not tracked (paper, section 3.3).

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.
    """

    def __init__(
        self,
        clocks_hz=(1000.0,),
        group_length=625,
        waveform="repeated",
        frame_length=720,
        sample_rate=12.5e6,
        clutter_hz=0.0,
        harmonics=8,
        tolerance_ppm=100.0,
        estimator="harmonic",
    ):
        sounding = sounding_waveform(waveform, frame_length, sample_rate)
        table = design_weights(
            clocks_hz, group_length, sounding.snapshot_period_s, clutter_hz, harmonics
        )
        tolerances = np.broadcast_to(np.asarray(tolerance_ppm, float), len(clocks_hz))
        clocks = [TagClock(f, float(ppm)) for f, ppm in zip(clocks_hz, tolerances, strict=True)]
        if estimator == "harmonic":
            self.separator = EndSeparator(table, clocks, sounding.averaging_s, sounding.bins)
        elif estimator == "paper":
            self.separator = PaperSeparator(table, clocks, sounding.averaging_s, sounding.bins)
        else:
            raise InputError("estimator", "must be 'harmonic' or 'paper'", estimator)
        self._equalizer = sounding.equalizer()
        self._rows = len(table.tones)
        self._incomplete = {}
        GroupBlock.__init__(self, "end_separation", self._rows * 64, 2 * len(clocks) * 64)
        self.message_port_register_in(pmt.intern(names.INCOMPLETE))
        self.set_msg_handler(pmt.intern(names.INCOMPLETE), self._on_incomplete)

    def _on_incomplete(self, message):
        meta = pmt.to_python(pmt.car(message))
        mask = np.asarray(meta[names.MASK], bool)
        folded = np.array(pmt.c32vector_elements(pmt.cdr(message)), complex)
        snapshots = np.fft.fft(folded.reshape(len(mask), 64), axis=1) * self._equalizer
        self._incomplete[int(meta[names.GROUP])] = (mask, snapshots)

    def take(self, tags, item):
        group = pmt.to_uint64(tags[names.GROUP])
        tones = item.reshape(self._rows, 64)
        if names.MISSING not in tags:
            return self._flat(self.separator.process(group, tones))
        if group not in self._incomplete:
            # Its snapshots are on their way by message: the item waits in the stream.
            return None
        mask, snapshots = self._incomplete.pop(group)
        return self._flat(self.separator.process(group, tones, mask, snapshots))

    @staticmethod
    def _flat(results):
        return [(state, vectors.ravel()) for state, vectors in results]
