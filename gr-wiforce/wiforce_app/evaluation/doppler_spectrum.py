# SPDX-License-Identifier: GPL-3.0-or-later
"""Doppler spectrum of a capture, for a picture."""

import tempfile
from pathlib import Path

import numpy as np
from gnuradio.wiforce.signal.waveform import FFT_LENGTH

_LENGTH = 5000  # snapshots per section
_KAISER_BETA = 14  # side lobes below -100 dB, so that a strong static path hides no line


def doppler_spectrum(recording, scene):
    """Average power spectrum over subcarriers and sections of a capture.

    Parameters
    ----------
    recording : Capture
    scene : Scene

    Returns
    -------
    dict
        ``hz``, from minus to plus half the snapshot rate, and ``db``; empty lists for a capture
        shorter than one section.
    """
    waveform = scene.waveform()
    with tempfile.TemporaryDirectory(dir=Path(recording.path).parent) as folder:
        channels = _channels(recording, scene, Path(folder) / "channels")
        sections = len(channels) // _LENGTH
        if not sections:
            return {"hz": [], "db": []}
        window = np.kaiser(_LENGTH, _KAISER_BETA)[:, None]
        power = np.zeros(_LENGTH)
        for number in range(sections):
            section = channels[number * _LENGTH : (number + 1) * _LENGTH, waveform.bins]
            lines = np.fft.fft(section * window, axis=0) / window.sum()
            power += np.mean(np.abs(lines) ** 2, axis=1) / sections
    level = 10 * np.log10(np.maximum(power, 1e-30))
    hz = np.fft.fftfreq(_LENGTH, scene.snapshot_period_s)
    return {
        "hz": np.fft.fftshift(hz).round(2).tolist(),
        "db": np.fft.fftshift(level).round(2).tolist(),
    }


def _channels(recording, scene, path):
    """H (N, 64) of every snapshot, computed through a temporary file."""
    from gnuradio import blocks, gr, wiforce

    factors = scene.waveform().equalizer().astype(np.complex64)
    flowgraph = gr.top_block("doppler spectrum", catch_exceptions=False)
    flowgraph.connect(
        wiforce.capture_source(recording, scene),
        wiforce.ofdm_channel_estimator(factors=factors),
        blocks.file_sink(FFT_LENGTH * gr.sizeof_gr_complex, str(path)),
    )
    flowgraph.run()
    return np.fromfile(path, np.complex64).reshape(-1, FFT_LENGTH)
