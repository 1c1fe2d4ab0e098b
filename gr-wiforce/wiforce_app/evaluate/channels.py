# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel of every snapshot of a capture, with nothing left out."""

import numpy as np
from gnuradio.wiforce.estimation.capture.folded_groups import frame_settings
from gnuradio.wiforce.wiforce_kernels import folded_reader
from scipy.fft import fft

# Samples of folded frames that are read at a time: 32 MB.
_BATCH = 1 << 22


def snapshot_channels(recording, scene, path):
    """Compute H of every snapshot of the first receive antenna.

    Returns memmap of complex64, shape (N, K): subcarriers as in the scene's waveform.

    ``path``: file that holds the result.
    """
    waveform = scene.waveform()
    factors = waveform.equalizer().astype(np.complex64)
    frames = folded_reader(**frame_settings(recording, waveform, frame_offset=0))
    with open(path, "wb") as file:
        while len(folded := frames.read(_BATCH // waveform.symbol_length)["folded"]):
            (fft(folded, axis=1) * factors).tofile(file)
    return np.memmap(path, np.complex64, "r").reshape(-1, waveform.symbol_length)[:, waveform.bins]
