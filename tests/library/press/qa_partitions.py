# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings do not depend on how groups are cut into batches, which load and GNU Radio decide."""

from itertools import repeat

import numpy as np
import pytest
from gnuradio import wiforce
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.receiver import make_readout
from plain import averaged_groups

GROUPS, FLUSHED, REPEATED = 90, (35, 60), 50
PLAN = wiforce.plan(
    {
        "sensors": [
            {"name": name, "model": "line-900mhz", "clock_hz": clock}
            for name, clock in (("s0", 1000.0), ("s1", 1400.0))
        ]
    }
)


def random_groups(seed):
    """Two sensors with presses, silences, new references, known or not, and a step of the receiver.

    Some groups are lost.
    """
    rng = np.random.default_rng(seed)
    model = wiforce.load_sensor("line-900mhz")
    degrees = 0.2 * rng.standard_normal((GROUPS, 4))
    readable = np.ones((GROUPS, 2), bool)
    for sensor in range(2):
        ends = slice(2 * sensor, 2 * sensor + 2)
        for begin in (20, 45, 70):
            first = begin + int(rng.integers(8))
            psi = model.phases_deg(rng.uniform(2, 6), rng.uniform(25, 55))
            degrees[first : first + int(rng.integers(3, 12)), ends] += psi - model.untouched_deg()
        silent = int(rng.integers(15, GROUPS))
        readable[silent : silent + int(rng.integers(1, 6)), sensor] = False
    receiver = np.exp(0.3j * (np.arange(GROUPS) >= rng.integers(15, GROUPS)))[:, None]
    ratios = np.exp(1j * np.radians(degrees)) * receiver
    step = np.ones((GROUPS, 4), complex)
    renewed = np.zeros(GROUPS, bool)
    for at in rng.choice(np.arange(15, GROUPS), 3, replace=False):
        renewed[at] = True
        step[at, 2 * rng.integers(2) :][:2] = rng.choice([np.nan, 1.1, np.exp(0.4j)])
    ratios /= np.cumprod(np.nan_to_num(step, nan=1.0), axis=0)
    received = np.flatnonzero(rng.random(GROUPS) > 0.05)
    static = 300 * receiver * np.exp(-0.03j * np.arange(62)) + rng.standard_normal((GROUPS, 62))
    return averaged_groups(
        ratios,
        locked=readable,
        retuned=np.arange(GROUPS) == rng.integers(2 * GROUPS),
        static=static,
        phase_std_deg=np.full((GROUPS, 4), 0.2),
        reference_power=np.ones((GROUPS, 4)),
        in_reference=np.repeat((np.arange(GROUPS) < 10)[:, None], 4, axis=1),
        new_reference=renewed,
        reference_step=step,
    )[received]


def read(groups, sizes):
    """Readings of groups in batches; with an end now and then, after which the run goes on.

    From ``REPEATED`` on another readout reads them, and the ten groups before once more, against
    another reference.
    """
    readout, readings = make_readout(PLAN), []
    again = groups[groups.index >= REPEATED - 10]
    again = again.having(ratios=again.ratios * np.exp(0.7j))
    parts = [groups[groups.index < FLUSHED[0]], groups[groups.index >= FLUSHED[0]]]
    parts[1] = parts[1][parts[1].index < REPEATED]
    states = None
    for part in (*parts, again[again.index < FLUSHED[1]], again[again.index >= FLUSHED[1]]):
        if len(part) and part.index[0] < REPEATED and part.index[-1] >= REPEATED:
            states = {name: sensor.state for name, sensor in readout.sensors.items()}
            readout = make_readout(PLAN, first_group=REPEATED, states=states)
        begin = 0
        while begin < len(part):
            size = int(next(sizes))
            readings += readout.process(part[begin : begin + size])
            begin += size
        readings += readout.flush()
    assert states is not None
    return readings


def values_of(readings):
    """Numbers, NaN where there is none, and words."""
    names = [name for name in Reading.__annotations__ if name not in ("sensor", "flags")]
    numbers = [[getattr(r, name) for name in names] for r in readings]
    return np.array(numbers, float), [(r.sensor, r.flags) for r in readings]


@pytest.mark.parametrize("seed", range(4))
def test_readings_are_those_of_any_partition_into_batches(seed, long_run):
    groups = random_groups(seed)
    expected, words = values_of(read(groups, repeat(GROUPS)))
    assert len(expected) > GROUPS and len({flags for _, flags in words}) > 3
    for partition in range(50 if long_run else 6):
        rng = np.random.default_rng([seed, partition])
        sizes = rng.integers(1, rng.choice([2, 3, 6, 31]), size=2 * GROUPS)
        found = values_of(read(groups, iter(sizes)))
        assert found[1] == words
        np.testing.assert_allclose(found[0], expected, rtol=1e-6, atol=1e-9)
