# SPDX-License-Identifier: GPL-3.0-or-later
"""Time from a group's last sample to its tones, at the pace of a radio."""

import time

import numpy as np
from gnuradio import blocks, gr
from gnuradio.wiforce.wiforce_bench import paced_source

from .recording import GROUP_SAMPLES, WAVEFORM
from .stream import ToneSink, collected_groups


def measure_latency(weights, packet, seconds):
    """Latency of the stream chain with packets of so many samples.

    Returns dict: ``packet``, ``median_ms``, ``p95_ms``, and ``core_share``: what part of a core the
    chain takes beside the paced source.
    """
    samples = int(seconds * WAVEFORM.sample_rate_hz)
    source = _paced(packet, samples)
    sink = ToneSink(weights)
    chain = _busy_share(source, collected_groups("fc32"), sink)
    if sink.failure is not None:
        raise sink.failure
    alone = _busy_share(_paced(packet, samples), blocks.null_sink(gr.sizeof_gr_complex))
    came = np.array(sink.times)
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
