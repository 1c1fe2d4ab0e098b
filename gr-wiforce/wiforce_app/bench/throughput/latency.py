# SPDX-License-Identifier: GPL-3.0-or-later
"""Time from a group's last sample to its tones, at the pace of a radio."""

import time

import numpy as np
from gnuradio import blocks, gr, wiforce
from gnuradio.wiforce.wiforce_bench import arrival_sink, paced_source

from .recording import GROUP_LENGTH, GROUP_SAMPLES, WAVEFORM


def measure_latency(weights, packet, seconds):
    """Latency of the stream chain with packets of so many samples.

    Returns
    -------
    dict
        ``packet``, ``median_ms``, ``p95_ms``, and ``core_share``: what part of a core the chain
        takes beside the paced source.
    """
    samples = int(seconds * WAVEFORM.sample_rate_hz)
    source = _paced(packet, samples)
    tones = wiforce.preamble_fold.tones(weights, GROUP_LENGTH, WAVEFORM.frame_length)
    estimator = wiforce.ofdm_channel_estimator(WAVEFORM.equalizer(), len(weights))
    arrivals = arrival_sink(64 * gr.sizeof_gr_complex * len(weights))
    chain = _busy_share(source, tones, estimator, arrivals)
    alone = _busy_share(_paced(packet, samples), blocks.null_sink(gr.sizeof_gr_complex))
    came = np.array(arrivals.times())
    latency_ms = 1e3 * (came - source.mark_times()[: len(came)])
    return {
        "packet": packet,
        "median_ms": round(float(np.median(latency_ms)), 4),
        "p95_ms": round(float(np.percentile(latency_ms, 95)), 4),
        "core_share": round(chain - alone, 4),
    }


def _paced(packet, samples):
    return paced_source(packet, WAVEFORM.sample_rate_hz, GROUP_SAMPLES, samples)


def _busy_share(*chain):
    """Processor time over time while a flowgraph runs."""
    flowgraph = gr.top_block()
    flowgraph.connect(*chain)
    started, busy = time.monotonic(), time.process_time()
    flowgraph.run()
    return (time.process_time() - busy) / (time.monotonic() - started)
