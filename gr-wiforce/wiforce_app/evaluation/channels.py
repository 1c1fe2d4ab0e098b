# SPDX-License-Identifier: GPL-3.0-or-later
"""The channel of every snapshot of a capture, with nothing left out."""

import numpy as np


def snapshot_channels(recording, scene, path):
    """Compute H of every snapshot of the first receive antenna.

    Parameters
    ----------
    recording : Capture
    scene : Scene
    path : Path
        File that holds the result.

    Returns
    -------
    memmap of complex64, shape (N, K)
        Subcarriers as in the scene's waveform.
    """
    from gnuradio import blocks, gr, wiforce

    waveform = scene.waveform()
    factors = waveform.equalizer().astype(np.complex64)
    flowgraph = gr.top_block("channels", catch_exceptions=False)
    flowgraph.connect(
        wiforce.capture_source(recording, scene),
        wiforce.ofdm_channel_estimator(factors=factors),
        blocks.file_sink(waveform.symbol_length * gr.sizeof_gr_complex, str(path)),
    )
    flowgraph.run()
    return np.memmap(path, np.complex64, "r").reshape(-1, waveform.symbol_length)[:, waveform.bins]
