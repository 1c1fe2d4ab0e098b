# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings of a surface whose strips are loaded by ``skin_law``, without samples."""

import numpy as np
from gnuradio.wiforce.io.readings import SurfaceReading
from gnuradio.wiforce.receiver import make_readout
from gnuradio.wiforce.sensor import load_sensor
from plain import averaged_groups
from skin_law import ALONG_MM, STRIPS_MM, strip_loads

CARRIER_HZ = 900e6
PERIOD_S = 0.036
NAMES, CLOCKS_HZ = ("a", "b", "c", "d"), (1035.0, 1165.0, 1365.0, 1480.0)
_TRUTH = "line-900mhz"
_NOISE_DEG = 0.1
# Groups before the presses, and groups of each.
_BEFORE, _EACH = 14, 5


def scene(models=f"{_TRUTH}-calibrated", **surface):
    """A scene of the strips, by default read with a noisy calibration of what is pressed."""
    clocks = zip(NAMES, CLOCKS_HZ, strict=True)
    return {
        "sensors": [
            {"name": name, "model": models.format(name), "clock_hz": hz} for name, hz in clocks
        ],
        "surface": {
            "strips": [
                {"sensor": name, "y_mm": float(y)} for name, y in zip(NAMES, STRIPS_MM, strict=True)
            ],
            **surface,
        },
    }


def shown_phases(presses, rng):
    """Phases (G, 4, 2) of strips under presses, each a list of (force, x, y)."""
    model = load_sensor(_TRUTH)
    phases = np.empty((len(presses), 4, 2))
    for g, now in enumerate(presses):
        phases[g] = model.untouched_deg()
        loads = [(strip_loads(force, y), x) for force, x, y in now]
        for strip in range(4):
            touching = [(load[strip], x) for load, x in loads if load[strip] >= 0.9]
            shown = [model.phases_deg(f, x - ALONG_MM[strip]) for f, x in sorted(
                touching, key=lambda contact: contact[1]
            )]  # fmt: skip
            if shown:
                phases[g, strip] = shown[0][0], shown[-1][1]
    return phases + _NOISE_DEG * rng.standard_normal(phases.shape)


def readings_of(plan, presses, rng, lost=None):
    """The readings of presses after a reference of 14 groups.

    Each is held for three groups, of which the second is returned, and two untouched groups follow.
    """
    held = [now for press in presses for now in (press, press, press, [], [])]
    model = load_sensor(_TRUTH)
    phases = shown_phases([*[[]] * _BEFORE, *held], rng)
    count = len(phases)
    ratios = np.exp(1j * np.radians(phases - model.untouched_deg())).reshape(count, 8)
    locked, std = np.ones((count, 4), bool), np.full((count, 8), _NOISE_DEG)
    if lost is not None:
        locked[:, lost] = False
        ratios[:, 2 * lost : 2 * lost + 2] = np.nan
        std[:, 2 * lost : 2 * lost + 2] = np.inf
    group = np.arange(count)
    in_reference = np.repeat((group < _BEFORE - 1)[:, None], 8, axis=1)
    first = {"new_reference": group == 0, "in_reference": in_reference}
    groups = averaged_groups(ratios, phase_std_deg=std, locked=locked, **first)
    readout = make_readout(plan)
    readings = readout.process(groups) + readout.flush()
    return [r for r in readings if r.group >= _BEFORE and (r.group - _BEFORE) % _EACH == 1]


def known_presses(along=(25.0, 40.0, 55.0)):
    """Taps at every 3 mm across and some places along: rows of force, x, y."""
    across = np.arange(-3.0, 40.0, 3.0)
    y, x = (values.ravel() for values in np.meshgrid(across, along))
    force = np.where(np.arange(len(y)) % 2, 5.0, 8.0)
    return np.column_stack([force, x, y])


def timed(taps, each=1):
    """Rows of the table of taps, each of so many presses of `readings_of`."""
    start = (_BEFORE + 1 + np.arange(len(taps)) * each * _EACH) * PERIOD_S
    return np.column_stack([start, start + (1 + (each - 1) * _EACH) * PERIOD_S, taps])


def write_taps(path, rows):
    header = "start_s,end_s,force_n,x_mm,y_mm"
    np.savetxt(path, rows, "%.9g", ",", header=header, comments="")


def of_surface(readings, name="skin"):
    """Readings of the surface, of the press with that name."""
    return [r for r in readings if isinstance(r, SurfaceReading) and r.sensor == name]


def errors_of(readings, presses):
    """Errors and standard deviations (n, 3) of touched readings, and the presses (n, 3)."""
    pairs = [(r, p) for r, p in zip(readings, presses, strict=True) if r.touch == 1]
    found = np.array([(r.force_n, r.location_mm, r.y_mm) for r, _ in pairs])
    std = np.array([(r.force_std_n, r.location_std_mm, r.y_std_mm) for r, _ in pairs])
    true = np.array([p for _, p in pairs])
    return found - true, std, true
