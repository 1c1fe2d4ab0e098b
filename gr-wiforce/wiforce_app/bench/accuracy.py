# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench accuracy``: phase errors of the estimators against the Cramer-Rao bound."""

import zlib
from dataclasses import dataclass, replace
from functools import lru_cache

import click
import numpy as np
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.estimation.estimators import RatioUnfolder, estimator_named
from gnuradio.wiforce.estimation.groups import Groups
from gnuradio.wiforce.estimation.phases.off_state import corrected_phase_deg
from gnuradio.wiforce.estimation.phases.reference import SubcarrierAverage
from gnuradio.wiforce.planning.plan import Plan
from gnuradio.wiforce.signal.carrier import wrap_deg
from gnuradio.wiforce.signal.waveform import sounding_waveform

from ..shell.log import progress
from ..shell.options import worker_options
from ..shell.tables import Column, echo, table
from ..shell.workers import run_tasks
from .air import Air, PathLevels, TagOnAir

_QUICK_RUNS, _FULL_RUNS = 10, 40
COLUMNS = (
    Column("case", "case"),
    Column("estimator", "estimator"),
    Column("rms (deg)", "rms_deg", ".3g"),
    Column("bound (deg)", "bound_deg", ".3g"),
    Column("loss (dB)", "loss_db", ".2f"),
    Column("in 2 std", "within_2_std", ".0%"),
    Column("n", "n"),
)


@click.command()
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of a table.")
@click.option(
    "--full", is_flag=True, help="4 000 errors per row instead of 1 000, and a run of 20 minutes."
)
@click.option("--case", "part", help="Run only cases whose name contains this.")
@worker_options
def accuracy(as_json, full, part, jobs):
    """Compare phase errors of each estimator with the Cramer-Rao bound.

    Monte Carlo simulation of channel snapshots: noise, fading, static and moving clutter, clock
    offset and drift, group length, off state, two tags, missing snapshots.
    """
    wanted = [case for case in cases(full) if (part or "") in case.name]
    if not wanted:
        raise click.BadParameter(f"no case has a name that contains {part!r}", param_hint="--case")
    rows = measure(wanted, _FULL_RUNS if full else _QUICK_RUNS, jobs)
    echo({"rows": rows}, as_json, lambda _: table(rows, COLUMNS))


def measure(wanted, runs, jobs):
    """Run cases so often, unless they say otherwise; a row per case and estimator."""
    # The longest first, so that all cores end at about the same time.
    tasks = [(case, run) for case in wanted for run in range(case.runs or runs)]
    tasks.sort(key=lambda task: -task[0].groups)
    results = {}
    with progress("measuring", len(tasks)) as step:
        for outcome in run_tasks(_work, tasks, jobs):
            case, run = tasks[outcome.index]
            results[case.name, run] = outcome.get()
            step(1)
    return [
        summarise(
            case,
            estimator,
            [results[case.name, run][estimator] for run in range(case.runs or runs)],
        )
        for case in wanted
        for estimator in case.estimators
    ]


def _work(task):
    return run_case(*task)


class SnapshotChain:
    """Snapshots of the channel in, ratios R out: the receiver without samples and sensors."""

    def __init__(self, plan):
        self.table = plan.table
        estimator = estimator_named(plan.estimator)
        self.separator = estimator.separator(
            plan.table, plan.clocks, plan.waveform, False, plan.others
        )
        self.difference = estimator.difference(
            len(plan.clocks), plan.reference_groups, plan.waveform
        )
        self.average = SubcarrierAverage()
        self.unfolder = RatioUnfolder(estimator.ratios)

    def process(self, index, snapshots, present=None):
        """Take H (N, K) of one group, ``present`` (N,); give the Groups ready, with ``ratios``."""
        if present is None or np.all(present):
            return self.process_tones(Groups([index], (self.table.weights @ snapshots)[None]))
        partial = self.table.for_present(present)
        tones = np.zeros((len(self.table.tones), snapshots.shape[1]), complex)
        if partial is not None:
            tones = partial.apply(snapshots[present])
        missing = np.array([np.sum(~present)])
        return self.process_tones(
            Groups([index], tones[None], missing, snapshot_weights=present[None])
        )

    def process_tones(self, groups):
        """As `process`, of a batch with tones (G, M, K)."""
        return self._finish(self.difference.process(self.separator.process(groups)))

    def flush(self):
        """Give the groups still held back."""
        ready = self.difference.process(self.separator.flush())
        return self._finish(Groups.concatenate([ready, self.difference.flush()]))

    def _finish(self, groups):
        return self.unfolder.process(self.average.process(groups))


ESTIMATORS = ("harmonic", "sideband", "paper", "paper, offset removed")
# Touched groups per run; each gives one error per end.
GROUPS_PER_RUN = 100
# Length of the untouched reference before them, in groups of 625.
REFERENCE_GROUPS = 12
_WAVEFORM = sounding_waveform()
_INTERFERED = slice(10, 22)  # subcarriers of 62 that an interferer covers, 20 dB over the noise


@dataclass(frozen=True)
class Case:
    """One case, which gives a row of the benchmark for every estimator.

    Levels in dB as of :class:`.PathLevels`; ``clutter_hz`` of the plan; ``off`` is |G_off / rho| at
    a random angle; ``lost`` a share of snapshots, ``at random`` or in a ``block``.
    """

    name: str
    gamma_db: float
    group_length: int = 625
    clocks_hz: tuple = (1000.0,)
    levels_db: tuple = (0.0,)
    static_db: float | None = 70.0
    movers_db: float | None = None
    clutter_hz: float = 0.0
    offset_ppm: float = 100.0
    drift_ppm_per_s: float = 0.5
    coherence_hz: float | None = 2e6
    off: float = 0.0
    off_given: bool = True
    lost: float = 0.0
    lost_in: str = "random"
    interfered: bool = False
    runs: int | None = None
    groups: int = GROUPS_PER_RUN
    estimators: tuple = ESTIMATORS

    @property
    def reference_groups(self):
        return round(REFERENCE_GROUPS * max(1.0, 625 / self.group_length))


def cases(full=False):
    """All cases, in the order of the report."""
    still = [Case(f"still, gamma {g:+d} dB", g) for g in (-20, -15, -10, 0, 10, 20, 30)]
    moving = [
        Case(f"walker and fan +30 dB, gamma {g:+d} dB", g, movers_db=30.0, clutter_hz=250.0)
        for g in (-20, -15, 0, 10, 20)
    ]
    base = Case("", 0.0, static_db=None)
    two = replace(base, clocks_hz=(1000.0, 1400.0), levels_db=(0.0, 0.0))
    others = [
        Case("walker and fan +40 dB, static +80 dB, gamma +20 dB", 20.0, static_db=80.0,
             movers_db=40.0, clutter_hz=400.0),
        replace(base, name="no static path"),
        replace(base, name="static +40 dB", static_db=40.0),
        replace(base, name="static +80 dB", static_db=80.0),
        replace(base, name="exact clock", offset_ppm=0.0, drift_ppm_per_s=0.0),
        replace(base, name="clock within 100 ppm, no drift", drift_ppm_per_s=0.0),
        replace(base, name="flat channel", coherence_hz=None),
        replace(base, name="N_g 63", group_length=63),
        replace(base, name="N_g 125", group_length=125),
        replace(base, name="N_g 125, walker and fan +30 dB", group_length=125, movers_db=30.0,
                clutter_hz=250.0),
        replace(base, name="N_g 250", group_length=250),
        replace(base, name="N_g 600, static +60 dB", group_length=600, static_db=60.0),
        replace(base, name="N_g 1250", group_length=1250),
        replace(base, name="off reflection .3, given, gamma +10 dB", gamma_db=10.0, off=0.3),
        replace(base, name="off reflection .3, not given, gamma +10 dB", gamma_db=10.0, off=0.3,
                off_given=False),
        replace(two, name="two tags, 1.0 and 1.4 kHz"),
        replace(two, name="two tags, second -20 dB, gamma +10 dB", gamma_db=10.0,
                levels_db=(0.0, -20.0)),
        replace(base, name="20 % of snapshots lost at random", lost=0.2),
        replace(base, name="20 % of snapshots lost in a block", lost=0.2, lost_in="block"),
        replace(base, name="interferer on 12 subcarriers", interfered=True),
    ]  # fmt: skip
    clean = replace(base, gamma_db=40.0, estimators=("harmonic",))
    clean_two = replace(clean, clocks_hz=(1000.0, 1400.0), levels_db=(0.0, 0.0))
    systematic = [
        replace(clean, name="systematic: static +80 dB, gamma +40 dB", static_db=80.0),
        replace(clean, name="systematic: off reflection .3 given, gamma +40 dB", off=0.3),
        replace(clean_two, name="systematic: two tags, gamma +40 dB"),
        replace(clean_two, name="systematic: two tags, second -20 dB, gamma +40 dB",
                levels_db=(0.0, -20.0)),
    ]  # fmt: skip
    long = [
        Case("20 minutes, gamma -15 dB", -15.0, runs=1, groups=33_320, estimators=("harmonic",))
    ]
    return still + moving + others + systematic + (long if full else [])


@dataclass(frozen=True)
class RunResult:
    """Errors, stated standard deviations and the bound of the touched groups read; (n, 2S) each."""

    errors_deg: np.ndarray
    std_deg: np.ndarray
    bound_deg: np.ndarray
    unread: int


def run_case(case, run):
    """Run a case once: a :class:`RunResult` per estimator, of the same snapshots."""
    air, tags, rng = air_of(case, run)
    kinds = dict.fromkeys(name.split(",")[0] for name in case.estimators)
    chains = {kind: SnapshotChain(plan_of(case, kind)) for kind in kinds}
    ready = {kind: [] for kind in kinds}
    mask = None
    for group in range(case.reference_groups + case.groups):
        snapshots = air.group(group, group >= case.reference_groups)
        mask = _present(case, rng)
        for kind, chain in chains.items():
            ready[kind].append(chain.process(group, snapshots, mask))
    groups = {kind: Groups.concatenate([*ready[kind], chains[kind].flush()]) for kind in kinds}
    bound = _bound(case, air, tags, mask)
    found = {}
    for name in case.estimators:
        kind = name.split(",")[0]
        errors, std, unread = errors_of(case, tags, groups[kind], kind)
        if name != kind:
            errors = wrap_deg(errors - _constant_offset(case, air))
        found[name] = RunResult(errors, std, np.broadcast_to(bound, errors.shape), unread)
    return found


def air_of(case, run):
    """The channel of one run of a case, its tags, and the random generator for the rest."""
    seeds = np.random.SeedSequence([1, zlib.crc32(case.name.encode()), run])
    rng = np.random.default_rng(seeds)
    tags = [_tag(case, *each, rng) for each in zip(case.clocks_hz, case.levels_db, strict=True)]
    levels = PathLevels(case.gamma_db, case.static_db, case.movers_db, case.coherence_hz)
    profile = np.ones(len(_WAVEFORM.bins))
    profile[_INTERFERED] = 100.0 if case.interfered else 1.0
    return Air(_WAVEFORM, case.group_length, tags, levels, seeds.spawn(1)[0], profile), tags, rng


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
    touched, untouched = (
        air.bound_deg(state, clutter_hz=case.clutter_hz, mask=mask) for state in (True, False)
    )
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


def _constant_offset(case, air):
    """Phase that the mean clock offset adds to the ends of touched groups, in degrees."""
    groups = np.arange(case.reference_groups + case.groups)
    times = groups * case.group_length * _WAVEFORM.snapshot_period_s
    gained = [360 * (clock.cycles(times) - clock.clock_hz * times) for clock in air.clocks]
    slope = np.polyfit(groups, np.transpose(gained), 1)[0]
    offset = np.outer(groups[case.reference_groups :], slope)
    return np.stack([offset, 4 * offset], axis=-1).reshape(len(offset), -1)


def summarise(case, estimator, runs):
    """Results of all runs as a row, an entry per end; loss is the mean of (error / bound)^2."""
    keys = ("errors_deg", "std_deg", "bound_deg")
    errors, std, bound = (np.concatenate([getattr(run, key) for run in runs]) for key in keys)
    values = dict.fromkeys(("rms_deg", "bound_deg", "loss_db", "within_2_std"))
    if len(errors):
        values = {
            "rms_deg": np.sqrt(np.mean(errors**2, axis=0)).tolist(),
            "bound_deg": np.sqrt(np.mean(bound**2, axis=0)).tolist(),
            "loss_db": (10 * np.log10(np.mean((errors / bound) ** 2, axis=0))).tolist(),
            "within_2_std": np.mean(np.abs(errors) <= 2 * std, axis=0).tolist(),
        }
    unread = sum(run.unread for run in runs)
    named = {"case": case.name, "estimator": estimator}
    return {**named, **values, "n": len(errors), "unread": unread}
