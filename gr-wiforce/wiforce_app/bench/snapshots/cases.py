# SPDX-License-Identifier: GPL-3.0-or-later
"""Cases of the accuracy benchmark."""

from dataclasses import dataclass, replace

ESTIMATORS = ("harmonic", "sideband", "paper", "paper, offset removed")
# Touched groups per run; each gives one error per end.
GROUPS_PER_RUN = 100
# Length of the untouched reference before them, in groups of 625.
REFERENCE_GROUPS = 12


@dataclass(frozen=True)
class Case:
    """One case, which gives a row of the benchmark for every estimator.

    ``gamma_db``: |a_k G|^2 relative to the noise in H, mean over the subcarriers. ``static_db`` and
    ``movers_db``: rms relative to line 1 of end 1. ``clutter_hz``: the clutter band of the
    plan. ``off``: |G_off / rho| at a random angle; ``off_given`` whether the reader knows it.
    ``lost``: share of missing snapshots, ``at random`` or in a ``block``.
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

    def run(self, run, seed):
        """Run once; estimator to ``RunResult``."""
        from .montecarlo import run_case

        return run_case(self, run, seed)

    def summarise(self, estimator, results):
        """Combine the results of all runs to a row."""
        from .montecarlo import summarise

        return summarise(self, estimator, results)


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
