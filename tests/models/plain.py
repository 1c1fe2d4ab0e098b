# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain references for the estimation: square waves by counting, and what tests share."""

import numpy as np
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.planning.plan import Plan
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.signal.waveform import sounding_waveform
from wiforce_app.bench.accuracy import SnapshotChain
from wiforce_app.bench.air import Air, PathLevels, TagOnAir

WAVEFORM = sounding_waveform()
T = WAVEFORM.snapshot_period_s
TA = WAVEFORM.averaging_s


def normal(rng, *shape):
    """Complex noise of variance 1."""
    return (rng.standard_normal(shape) + 1j * rng.standard_normal(shape)) / np.sqrt(2)


def _both_on(cycles, delay_cycles, duty):
    """Whether each switch is on: near whole cycles, and near odd quarters."""
    near_quarter = cycles - (delay_cycles + 0.25)
    first = np.abs(cycles - np.rint(cycles)) < duty[0] / 2
    return first, np.abs(near_quarter - np.rint(2 * near_quarter) / 2) < duty[1] / 4


def averaged_switches(
    centre_cycles, width_cycles, delay_cycles=0.0, points=4001, duty=(0.25, 0.25)
):
    """Both switches averaged over windows by counting ``points`` instants; (n, 2)."""
    centre_cycles = np.asarray(centre_cycles)
    inside = width_cycles * ((np.arange(points) + 0.5) / points - 0.5)
    averaged = np.empty((len(centre_cycles), 2))
    for start in range(0, len(averaged), 256):  # as much as fits into a cache
        part = slice(start, start + 256)
        on = _both_on(centre_cycles[part, None] + inside, delay_cycles, duty)
        averaged[part] = np.transpose([np.count_nonzero(each, axis=1) for each in on]) / points
    return averaged


def make_plan(clocks_hz=(1000.0,), group_length=625, clutter_hz=0.0, reference_groups=12, **more):
    """A reader's plan without a scene."""
    settings = {"harmonics": 8, "smoothing_groups": 1, "estimator": "harmonic"} | more
    clocks = tuple(TagClock(f) for f in clocks_hz)
    return Plan(
        WAVEFORM, clocks, group_length, clutter_hz, reference_groups=reference_groups, **settings
    )


def random_tag(rng, **fixed):
    """A tag of unknown clock phase and offset, with any phases before and in the touch."""
    drawn = {
        "offset_ppm": rng.uniform(-100, 100),
        "drift_ppm_per_s": rng.choice([-0.5, 0.5]),
        "start_cycles": rng.random(),
        "untouched_deg": tuple(rng.uniform(-180, 180, 2)),
        "touched_deg": tuple(rng.uniform(-180, 180, 2)),
    }
    return TagOnAir(**(drawn | fixed))


def turned_deg(tags):
    """True phase change of every end in the touch; (2S,)."""
    return np.concatenate([np.subtract(tag.touched_deg, tag.untouched_deg) for tag in tags])


def run_chain(plan, air, groups, present=None, on=None):
    """Untouched while the reference lasts, touched afterwards.

    ``present(group)`` gives the snapshots there are, ``on(group)`` whether the tags are on.
    Returns all groups as one batch of Groups, with ``ratios``.
    """
    chain = SnapshotChain(plan)
    ready = []
    for g in range(groups):
        snapshots = air.group(g, g >= plan.reference_groups, True if on is None else on(g))
        ready.append(chain.process(g, snapshots, None if present is None else present(g)))
    return Groups.concatenate([*ready, chain.flush()])


def errors_deg(results, tags, reference_groups=12):
    """Error of arg R in every touched group; (groups, 2S)."""
    touched = results.ratios[results.index >= reference_groups]
    return wrap_deg(np.degrees(np.angle(touched)) - turned_deg(tags))


def stated_deg(results, reference_groups=12):
    """Stated standard deviation of arg R in every touched group; (groups, 2S)."""
    return results.phase_std_deg[results.index >= reference_groups]


def make_air(group_length, tags, seed, gamma_db, noise_profile=None, **levels):
    """The air of a test."""
    return Air(WAVEFORM, group_length, tags, PathLevels(gamma_db, **levels), seed, noise_profile)


def averaged_groups(ratios, **more):
    """Groups of ratios (G, 2S), in which nothing happens to the tags but what is given."""
    count, none = len(ratios), np.zeros(np.shape(ratios), bool)
    usual = {
        "phase_std_deg": np.full(none.shape, 0.1),
        "snr_db": np.full(none.shape, 10.0),
        "locked": ~none[:, ::2],
        "overlapping": none[:, ::2],
        "new_reference": none[:, 0],
        "in_reference": none,
        "late_reference": none,
        "reshaped": none,
        "reference_step": np.ones(none.shape, complex),
    }
    return Groups(more.pop("index", np.arange(count)), ratios=ratios, **(usual | more))
