# SPDX-License-Identifier: GPL-3.0-or-later
"""The chain of one block per step and the reader, on the same samples."""

from gnuradio import gr, wiforce

# Between the blocks of the chain items have single precision.
FORCE_LIMIT_N = LOCATION_LIMIT_MM = PHASE_LIMIT_DEG = 1e-4
EXACT = ("time_s", "sensor", "touch", "flags", "group")
CLOSE = {
    "phase1_deg": PHASE_LIMIT_DEG,
    "phase2_deg": PHASE_LIMIT_DEG,
    "force_n": FORCE_LIMIT_N,
    "force_std_n": FORCE_LIMIT_N,
    "location_mm": LOCATION_LIMIT_MM,
    "location_std_mm": LOCATION_LIMIT_MM,
    "snr_db": 1e-3,
    "interference": 1e-6,
}


class Chain:
    """One block per step, from snapshots to readings."""

    def __init__(self, plan, on_reading, tracked=False, port="incomplete"):
        self._port = port
        self.doppler = wiforce.phase_group_doppler(plan.table.weights, plan.group_length)
        self.channel = wiforce.ofdm_channel_estimator(
            plan.waveform.equalizer(),
            len(plan.table.tones),
            plan.table.derotation(plan.waveform.sample_rate_hz),
        )
        self.separation = wiforce.end_separation(plan)
        self.difference = wiforce.conjugate_difference(plan)
        self.average = wiforce.subcarrier_average(plan)
        self.inversion = wiforce.force_inversion(plan, tracked, on_reading=on_reading)
        self.in_python = [self.separation, self.difference, self.average, self.inversion]

    def connect(self, flowgraph, *before):
        flowgraph.connect(*before, self.doppler, self.channel, *self.in_python)
        if self._port:
            flowgraph.msg_connect(self.doppler, self._port, self.separation, self._port)

    @property
    def failures(self):
        return [block.failure for block in self.in_python if block.failure is not None]


def readings_of_chain(plan, *before, runs=1, **options):
    """Readings by one block per step, behind blocks that give snapshots."""
    readings, flowgraph = [], gr.top_block()
    chain = Chain(plan, readings.append, **options)
    chain.connect(flowgraph, *before)
    for _ in range(runs):
        flowgraph.run()
    assert chain.failures == [] and chain.inversion.ended.is_set()
    return readings


def readings_of_reader(plan, source, input_type="sc16", runs=1, **options):
    """Readings by the block that holds the whole receiver."""
    readings, flowgraph = [], gr.top_block()
    reader = wiforce.reader(plan, input_type, on_reading=readings.append, **options)
    flowgraph.connect(source, reader)
    for _ in range(runs):
        flowgraph.run()
    assert reader.failure is None
    return readings


def assert_equal_readings(found, expected):
    """Compare readings group by group: touch, force, location, phases and flags."""
    assert len(found) == len(expected)
    for own, other in zip(found, expected, strict=True):
        assert [getattr(own, name) for name in EXACT] == [getattr(other, name) for name in EXACT]
        for name, limit in CLOSE.items():
            value, wanted = getattr(own, name), getattr(other, name)
            assert (value is None) == (wanted is None), (name, own.group)
            assert value is None or abs(value - wanted) <= limit, (name, own.group)
