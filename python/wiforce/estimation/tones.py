# SPDX-License-Identifier: GPL-3.0-or-later
"""The tones of some tags' clocks, as the blocks of the chain want them: without a scene.

All take those settings of ``end_separation`` that make the tones, by the same names.
"""

import numpy as np

from ..signal.lines import tag_lines
from ..signal.waveform import sounding_waveform
from ..signal.weights import design_weights
from .estimators import estimator_named


def tone_table(
    clocks_hz,
    group_length=625,
    frame_length=720,
    sample_rate=12.5e6,
    clutter_hz=0.0,
    harmonics=8,
    estimator="harmonic",
):
    """The tones and the weights that take them: an ``signal.weights.ToneTable``.

    Raises
    ------
    InputError
        (A ValueError) naming parameter, rule and value.
    """
    period = _snapshot_period(frame_length, sample_rate)
    rectangular = estimator_named(estimator).rectangular
    return design_weights(clocks_hz, group_length, period, clutter_hz, harmonics, rectangular)


def _snapshot_period(frame_length, sample_rate):
    return sounding_waveform("repeated", frame_length, sample_rate).snapshot_period_s


def tone_weights(
    clocks_hz,
    group_length=625,
    frame_length=720,
    sample_rate=12.5e6,
    clutter_hz=0.0,
    harmonics=8,
    estimator="harmonic",
):
    """Weight table for ``phase_group_doppler`` that suits ``end_separation`` of the same settings.

    Returns
    -------
    ndarray of complex64, shape (M, group_length)
    """
    settings = (clocks_hz, group_length, frame_length, sample_rate, clutter_hz, harmonics)
    return tone_table(*settings, estimator).weights.astype(np.complex64)


def tone_count(
    clocks_hz,
    group_length=625,
    frame_length=720,
    sample_rate=12.5e6,
    clutter_hz=0.0,
    harmonics=8,
    estimator="harmonic",
):
    """Rows M of ``tone_weights`` of the same settings; as many with any estimator."""
    estimator_named(estimator)
    period = _snapshot_period(frame_length, sample_rate)
    return len(tag_lines(clocks_hz, period, group_length, harmonics, clutter_hz))


def tone_derotation(
    clocks_hz,
    group_length=625,
    frame_length=720,
    sample_rate=12.5e6,
    clutter_hz=0.0,
    harmonics=8,
    estimator="harmonic",
):
    """Factors for ``ofdm_channel_estimator`` that stop each tone's turning within a symbol.

    Returns
    -------
    ndarray of complex64, shape (M, 64)
    """
    settings = (clocks_hz, group_length, frame_length, sample_rate, clutter_hz, harmonics)
    return tone_table(*settings, estimator).derotation(sample_rate).astype(np.complex64)
