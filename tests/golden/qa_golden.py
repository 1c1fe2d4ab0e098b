# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings are what they were: changed code, the same numbers."""

from collections import Counter

import cases
import faults
import numpy as np
import pytest

# Other libraries round some of the simulated samples to the next integer: unflagged readings on
# Debian 13 are up to 7e-3 of their standard deviation apart, flagged ones up to 0.7.
AS_STORED = np.__version__.startswith("1.24.")
# What a reading may change by, as a part of its standard deviation: far below what anybody could
# notice, far above rounding (1e-9), which batches of other sizes or another order of sums bring.
ALLOWED = 1e-3 if AS_STORED else 1e-2
# In groups that lack snapshots or are saturated, rounding of single precision is amplified, and it
# depends on the width of the processor's vectors: with AVX2 instead of AVX-512 readings change by
# up to 2.7e-3.
ALLOWED_IN_FAULTS = 1e-2
FAULTS = {"gap", "saturated"}
STD = {"force_n": "force_std_n", "location_mm": "location_std_mm", "y_mm": "y_std_mm"}
# Standard deviation of a phase in one group of the scenes that every run reads; better scenes are
# held by force and location. An SNR need not be known that well.
SCALE = {"time_s": 1e-6, "phase1_deg": 0.08, "phase2_deg": 0.08, "snr_db": 0.1}
QUICK = [*cases.QUICK, "tabletop_two-tracked"]
QUICK += [fault.__name__ for fault in faults.FAULTS[::3]] + ["sequence2"]


def pytest_generate_tests(metafunc):
    every = metafunc.config.getoption("--long")
    metafunc.parametrize("case", cases.all_cases() if every else QUICK)


@pytest.fixture(scope="module")
def captures(tmp_path_factory):
    return tmp_path_factory.mktemp("captures")


def kinds(readings):
    """How often each flag and each decision on touch occurs."""
    words = [word for flags in readings["flags"] for word in flags.split()]
    return Counter(words + [f"touch {touch}" for touch in readings["touch"]])


def differences(case, folder):
    """What differs between the stored readings of a case and those made now, in words."""
    old, new = cases.stored(case), cases.make(case, folder)
    if len(old["time_s"]) != len(new["time_s"]):
        return [f"{len(new['time_s'])} readings instead of {len(old['time_s'])}"]
    found = [f"sensors are {set(new['sensor'])}"] if (old["sensor"] != new["sensor"]).any() else []
    counts, now = kinds(old), kinds(new)
    found += [
        f"{kind} {now[kind]} times, was {counts[kind]}"
        for kind in sorted(counts | now)
        if counts[kind] != now[kind]
    ]
    faulty = np.array([bool(FAULTS & set(flags.split())) for flags in old["flags"]], bool)
    allowed = np.where(faulty, ALLOWED_IN_FAULTS, ALLOWED)
    for name in (*cases.NUMBERS, *(name for name in cases.ON_SURFACE if name in old)):
        # Standard deviations are compared with themselves.
        scale = old[STD[name]] if name in STD else SCALE.get(name, np.abs(old[name]))
        apart = np.abs(new[name] - old[name]) > allowed * scale
        apart |= np.isnan(new[name]) != np.isnan(old[name])
        # Where one of the readings is doubtful, so is a number.
        apart &= (old["flags"] == "") & (new["flags"] == "") & (old["touch"] == new["touch"])
        found += [
            f"{name} of row {i}: {new[name][i]!r}, was {old[name][i]!r}"
            for i in np.flatnonzero(apart)
        ]
    return found


def test_readings_are_those_stored(case, captures):
    found = differences(case, captures)
    assert not found, "\n".join(found[:10] + [f"{len(found)} differences"])
