# SPDX-License-Identifier: GPL-3.0-or-later
"""Runs of the accuracy benchmark: errors of every estimator on the same snapshots."""

import time
import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.phases.off_state import corrected_phase_deg
from gnuradio.wiforce.planning.plan import Plan
from gnuradio.wiforce.signal.bound import phase_bound_deg
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.signal.waveform import sounding_waveform

from .air import Air, PathLevels, TagOnAir
from .chain import SnapshotChain

_WAVEFORM = sounding_waveform()
_PARTS = 20  # into which a single long run is divided, for its confidence interval
_INTERFERED = slice(10, 22)  # subcarriers of 62 that an interferer covers, 20 dB over the noise


@dataclass(frozen=True)
class RunResult:
    """One run of one estimator.

    Attributes
    ----------
    errors_deg : ndarray, shape (n, 2S)
        Errors of the touched groups that were read.
    std_deg : ndarray, shape (n, 2S)
        Standard deviations that the reader states.
    bound_deg : ndarray, shape (2S,)
        Bound of this realisation.
    unread : int
        Touched groups without a reading.
    cpu_s, signal_s : float
        Processor time, and the duration of the signal.
    """

    errors_deg: np.ndarray
    std_deg: np.ndarray
    bound_deg: np.ndarray
    unread: int
    cpu_s: float
    signal_s: float


def run_case(case, run, seed=1):
    """Run a case once: the reference, then touched groups; the same snapshots for all estimators.

    Returns dict: estimator to :class:`RunResult`.
    """
    air, tags, rng = air_of(case, run, seed)
    kinds = dict.fromkeys(name.split(",")[0] for name in case.estimators)
    chains = {kind: SnapshotChain(plan_of(case, kind)) for kind in kinds}
    results = {kind: [] for kind in kinds}
    spent = dict.fromkeys(kinds, 0.0)
    cycles, mask = [], None
    for group in range(case.reference_groups + case.groups):
        snapshots = air.group(group, group >= case.reference_groups)
        cycles.append([clock.cycles(air.times_s(group).mean()) for clock in air.clocks])
        mask = _present(case, rng)
        for kind, chain in chains.items():
            began = time.process_time()
            results[kind].append(chain.process(group, snapshots, mask))
            spent[kind] += time.process_time() - began
    for kind, chain in chains.items():
        results[kind] = Groups.concatenate([*results[kind], chain.flush()])
    bound = _bound(case, air, tags, mask)
    signal_s = len(cycles) * case.group_length * _WAVEFORM.snapshot_period_s
    found = {}
    for name in case.estimators:
        kind = name.split(",")[0]
        errors, std, unread = errors_of(case, tags, results[kind], kind)
        if name != kind:
            errors = wrap_deg(errors - _constant_offset(case, np.array(cycles)))
        found[name] = RunResult(errors, std, bound, unread, spent[kind], signal_s)
    return found


def air_of(case, run, seed=1):
    """The channel of one run of a case, its tags, and the random generator for the rest."""
    seeds = np.random.SeedSequence([seed, zlib.crc32(case.name.encode()), run])
    rng = np.random.default_rng(seeds)
    tags = [_tag(case, hertz, level, rng) for hertz, level in _each_tag(case)]
    levels = PathLevels(case.gamma_db, case.static_db, case.movers_db, case.coherence_hz)
    profile = np.ones(len(_WAVEFORM.bins))
    profile[_INTERFERED] = 100.0 if case.interfered else 1.0
    return Air(_WAVEFORM, case.group_length, tags, levels, seeds.spawn(1)[0], profile), tags, rng


def _each_tag(case):
    return zip(case.clocks_hz, case.levels_db, strict=True)


def _tag(case, clock_hz, level_db, rng):
    # The drift must not leave the tolerance of the crystal.
    room = max(case.offset_ppm - 0.5 * case.drift_ppm_per_s * 10, 0.0)
    return TagOnAir(
        clock_hz,
        level_db,
        rng.uniform(-room, room) if room else 0.0,
        case.drift_ppm_per_s * rng.choice([-1, 1]),
        rng.random(),
        tuple(rng.uniform(-180, 180, 2)),
        tuple(rng.uniform(-180, 180, 2)),
        case.off * np.exp(2j * np.pi * rng.random()),
    )


@lru_cache(maxsize=8)
def plan_of(case, estimator):
    """The plan by which a case is read."""
    return Plan(
        _WAVEFORM,
        tuple(TagClock(hertz) for hertz in case.clocks_hz),
        case.group_length,
        case.clutter_hz,
        8,
        case.reference_groups,
        1,
        estimator,
    )


def _present(case, rng):
    if not case.lost:
        return None
    count = round(case.lost * case.group_length)
    gone = rng.permutation(case.group_length)[:count]
    if case.lost_in == "block":
        gone = np.arange(count) + rng.integers(case.group_length - count + 1)
    mask = np.ones(case.group_length, bool)
    mask[gone] = False
    return mask


def _bound(case, air, tags, mask):
    """Bound of the phases psi of a touched group, including the noise of the reference."""
    clocks = [(clock.actual_hz, 2 * np.pi * clock.cycles(0.0)) for clock in air.clocks]
    times = np.arange(case.group_length) * _WAVEFORM.snapshot_period_s
    touched, untouched = (
        phase_bound_deg(
            air.ends(state), air.noise, clocks, times, _WAVEFORM.averaging_s, case.clutter_hz,
            mask=mask,
        )
        for state in (True, False)
    )  # fmt: skip
    # |d psi / d arg R| of each end; |G| is 1.
    slope = np.concatenate(
        [np.abs(np.exp(1j * np.radians(t.touched_deg)) - t.off_reflection) for t in tags]
    )
    return slope * np.sqrt(touched**2 + untouched**2 / case.reference_groups)


def errors_of(case, tags, groups, kind):
    """Errors and stated std (n, 2S) of the touched groups, and the number without a reading."""
    truth = np.concatenate([tag.touched_deg for tag in tags])
    touched = groups[groups.index >= case.reference_groups]
    known = np.all(np.isfinite(touched.phase_std_deg), axis=1)
    read = touched[known]
    errors, slopes = _error(case, tags, read.ratios, truth)
    if kind == "sideband":
        # Half the angle is ambiguous by 180 degrees.
        opposite, others = _error(case, tags, -read.ratios, truth)
        nearer = np.abs(opposite) < np.abs(errors)
        errors, slopes = np.where(nearer, opposite, errors), np.where(nearer, others, slopes)
    return errors, read.phase_std_deg * slopes, int(np.sum(~known))


def _error(case, tags, ratios, truth):
    """Errors of psi in degrees, and |d psi / d arg R|; (n, 2S) each."""
    psi, slope = zip(
        *(
            corrected_phase_deg(
                ratios[:, 2 * i : 2 * i + 2],
                tag.untouched_deg,
                tag.off_reflection if case.off_given else 0.0,
            )
            for i, tag in enumerate(tags)
        ),
        strict=True,
    )
    return wrap_deg(np.hstack(psi) - truth), np.hstack(slope)


def _constant_offset(case, cycles):
    """Phase that the mean clock offset adds to the ends of touched groups, in degrees."""
    groups = np.arange(len(cycles))
    nominal = np.array(case.clocks_hz) * case.group_length * _WAVEFORM.snapshot_period_s
    rotation_deg = 360 * (cycles - cycles[0] - np.outer(groups, nominal))
    slope = np.polyfit(groups, rotation_deg, 1)[0]
    offset = np.outer(groups[case.reference_groups :], slope)
    return np.stack([offset, 4 * offset], axis=-1).reshape(len(offset), -1)


@dataclass(frozen=True)
class Row:
    """Results of a case and an estimator over all runs; lists have an entry per end."""

    case: str
    estimator: str
    rms_deg: list
    bias_deg: list
    bound_deg: list
    loss_db: list
    loss_interval_db: list
    within_2_std: list
    seconds_per_second: float
    n: int
    unread: int


def summarise(case, estimator, runs):
    """Combine the results of all runs to a row.

    The loss is the mean of (error / bound of its realisation)^2. Errors within a run share their
    reference, so the 95 % interval comes from the spread between runs, or between the parts of a
    single long run.
    """
    from scipy.stats import t as student

    unread = sum(run.unread for run in runs)
    runs = [run for run in runs if len(run.errors_deg)]
    if not runs:
        nothing = [None] * (2 * len(case.clocks_hz))
        return Row(case.name, estimator, *([nothing] * 6), 0.0, 0, unread)
    errors = np.concatenate([run.errors_deg for run in runs])
    std = np.concatenate([run.std_deg for run in runs])
    relative = [(run.errors_deg / run.bound_deg) ** 2 for run in runs]
    if len(runs) == 1:
        relative = np.array_split(relative[0], _PARTS)
    losses = np.array([part.mean(axis=0) for part in relative])
    mean = losses.mean(axis=0)
    half = student.ppf(0.975, len(losses) - 1) * losses.std(axis=0, ddof=1) / np.sqrt(len(losses))
    interval = 10 * np.log10([np.maximum(mean - half, 1e-3 * mean), mean + half])
    return Row(
        case.name,
        estimator,
        np.sqrt(np.mean(errors**2, axis=0)).tolist(),
        np.mean(errors, axis=0).tolist(),
        np.sqrt(np.mean([run.bound_deg**2 for run in runs], axis=0)).tolist(),
        (10 * np.log10(mean)).tolist(),
        interval.T.tolist(),
        np.mean(np.abs(errors) <= 2 * std, axis=0).tolist(),
        sum(run.cpu_s for run in runs) / sum(run.signal_s for run in runs),
        len(errors),
        unread,
    )
