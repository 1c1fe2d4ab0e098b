# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: tones of a group to the complex channels of the tags' ends."""

from dataclasses import replace

import numpy as np
import pmt
from gnuradio import gr

from .. import names
from ..errors import InputError
from ..estimation.estimators import estimator_named
from ..estimation.tones import tone_table
from ..estimation.tracked_tag import TagClock
from ..signal.waveform import sounding_waveform
from .group_block import GroupBlock

# Snapshots with samples at full scale from which on a group counts as clipped. A recording that
# was scaled to its own peak reaches full scale here and there; it lost nothing by that.
_CLIPPED_SHARE = 0.01


def _tolerances(tolerance_ppm, tags):
    tolerances = np.atleast_1d(np.asarray(tolerance_ppm, float))
    if tolerances.shape not in ((1,), (tags,)):
        raise InputError("tolerance_ppm", f"must be one number, or {tags}", tolerance_ppm)
    if not np.all((tolerances >= 0) & (tolerances <= 1000)):
        raise InputError("tolerance_ppm", "must be from 0 to 1000", tolerance_ppm)
    return np.broadcast_to(tolerances, tags)


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
        ``harmonic``; ``paper``: lines +1 and +4 alone, clock not tracked (paper, section 3.3);
        ``sideband``: the product of lines +-1 and of +-4, the square of each end.
    derotated : bool
        Whether the channel estimator was given ``tone_derotation(...)`` of the same settings.

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
        derotated=True,
    ):
        sounding = sounding_waveform(waveform, frame_length, sample_rate)
        table = tone_table(
            clocks_hz, group_length, frame_length, sample_rate, clutter_hz, harmonics, estimator
        )
        tolerances = _tolerances(tolerance_ppm, len(clocks_hz))
        clocks = [TagClock(f, float(ppm)) for f, ppm in zip(clocks_hz, tolerances, strict=True)]
        self.separator = estimator_named(estimator).separator(
            table, clocks, sounding.averaging_s, sounding.bins, sample_rate if derotated else None
        )
        self._table = table
        self._rotation = table.derotation(sample_rate) if derotated else 1.0
        self._equalizer = sounding.equalizer()
        self._rows = len(table.tones)
        self._incomplete, self._marks = {}, {}
        self._awaited = None
        GroupBlock.__init__(self, "end_separation", self._rows * 64, 2 * len(clocks) * 64)
        self.message_port_register_in(pmt.intern(names.INCOMPLETE))
        self.set_msg_handler(pmt.intern(names.INCOMPLETE), self._on_incomplete)

    def _on_incomplete(self, message):
        try:
            meta = pmt.to_python(pmt.car(message))
            mask = np.asarray(meta[names.MASK], bool)
            folded = np.array(pmt.c32vector_elements(pmt.cdr(message)), complex)
            self._incomplete[int(meta[names.GROUP])] = (mask, folded.reshape(len(mask), 64))
        except Exception as error:
            self.fail(error)

    def take(self, tags, item):
        group = pmt.to_uint64(tags[names.GROUP])
        marks = self._marks_of(tags)
        if marks:
            self._marks[group] = marks
        if names.MISSING not in tags:
            return self._flat(self.separator.process(group, item.reshape(self._rows, 64)))
        if group not in self._incomplete and self._awaited != group:
            # Its snapshots were sent before it: the item waits until messages are taken.
            self._awaited = group
            return None
        missing = pmt.to_uint64(tags[names.MISSING])
        return self._flat(self.separator.process(group, *self._solved(group, missing)))

    def _solved(self, group, missing):
        """Tones of a group with gaps, snapshots missing, and the weights for those present."""
        tones = np.zeros((self._rows, 64), complex)
        if group not in self._incomplete:
            gr.log.warn(f"end_separation: no snapshots of group {group}: connect 'incomplete'")
            return tones, missing, None
        mask, folded = self._incomplete.pop(group)
        partial = self._table.for_present(mask)
        if partial is not None:
            tones = partial.weights @ folded[mask]
            tones = np.fft.fft(tones * self._rotation, axis=1) * self._equalizer
        return tones, missing, partial

    def _marks_of(self, tags):
        """Fields of GroupState that tags decide."""
        marks = {}
        if names.SATURATED in tags:
            clipped = pmt.to_uint64(tags[names.SATURATED])
            marks["saturated"] = clipped >= _CLIPPED_SHARE * self._table.group_length
        if names.RETUNED in tags:
            marks["retuned"] = True
        return marks

    def flush(self):
        """The groups that still wait for the clocks: (GroupState, V (2S, K)) of each."""
        return self._complete(self.separator.flush())

    def _flat(self, results):
        return [(state, vectors.ravel()) for state, vectors in self._complete(results)]

    def _complete(self, results):
        return [
            (replace(state, **self._marks.pop(state.group, {})), vectors)
            for state, vectors in results
        ]
