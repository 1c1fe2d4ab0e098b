# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the calibrated sensors: build/run python3 gr-wiforce/sensors/make_sensors.py [FOLDER]

Sensors by their physics, which these are calibrations of, are files written by hand.
"""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import measure_vna, read_vna_csv
from gnuradio.wiforce.sensor import load_sensor, write_sensor

HERE = Path(__file__).resolve().parent
PUBLISHED = HERE.parent / "data" / "paper" / "vna.csv"
FREQUENCIES_MHZ = (900, 2400)
# In the middle of the bands at 902-928 MHz and 2400-2483.5 MHz; each from the paper's carrier.
UNLICENSED_MHZ = {915: 900, 2440: 2400}
DATE = "2026-11-21"
# Just under the least published force.
ONSET_FORCE_N = 0.9
FORCES_N = np.arange(0.5, 8.1, 0.25)
# The stamp that a fingertip's sensor is calibrated with is a little narrower than a finger. What
# touches a line at ONSET_FORCE_N at a point bends it by less when it is as wide.
STAMP_WIDTH_MM, STAMP_ONSET_N = 16.0, 1.723


def calibrated(name, model, source, seed):
    """A model of what is known by its physics, from a simulated VNA with noise."""
    table = measure_vna(model, (20, 30, 40, 50, 60), FORCES_N, noise_deg=0.2, seed=seed)
    return calibrate(table, f"{name}-calibrated", source=f"a VNA's sweep of {source}", date=DATE)


def line_calibrated(mhz):
    """A model of the physical line."""
    name = f"line-{mhz}mhz"
    source = (
        f"{name}, simulated: 0.5 to 8 N at 20, 30, 40, 50 and 60 mm with 0.2 deg of noise "
        f"(measure_vna, seed {mhz})"
    )
    return calibrated(name, load_sensor(name), source, mhz)


def calibrated_stamp(mhz):
    """A calibration for fingertips."""
    name, seed = f"fingertip-{mhz}mhz", mhz + 2
    finger = load_sensor(name)
    contact = replace(finger.contact, width_mm=STAMP_WIDTH_MM)
    stamp = replace(
        finger, contact=contact, onset_force_n=STAMP_ONSET_N, force_span_n=(STAMP_ONSET_N, 10.0)
    )
    source = (
        f"line-{mhz}mhz pressed with a stamp {STAMP_WIDTH_MM:g} mm wide, simulated as that of "
        f"line-{mhz}mhz (seed {seed})"
    )
    return calibrated(name, stamp, source, seed)


def calibrated_plain_trace():
    """What a calibration makes of the plain trace: curves that are flat against force."""
    name = "plain-trace-900mhz"
    source = f"{name}, simulated as that of line-900mhz (seed 901)"
    return calibrated(name, load_sensor(name), source, 901)


@cache
def published(kind, mhz):
    """``paper``: as published; ``wiforce``: its movement with force, the line's location steps."""
    settings = {
        "paper": {"location_steps": "given"},
        "wiforce": {"location_steps": "line", "mirror": mhz == 2400},
    }
    return calibrate(
        read_vna_csv(PUBLISHED, mhz * 1e6),
        f"{kind}-{mhz}mhz",
        form="auto-beyond",
        onset_force_n=ONSET_FORCE_N,
        source="published VNA curves of the WiForce paper, NSDI 2021 (data/paper/vna.csv)",
        date=DATE,
        **settings[kind],
    )


def all_sensors():
    """Every calibrated sensor that is shipped."""
    for mhz in FREQUENCIES_MHZ:
        yield line_calibrated(mhz)
        yield published("paper", mhz)
        yield published("wiforce", mhz)
        yield calibrated_stamp(mhz)
    for mhz, published_mhz in UNLICENSED_MHZ.items():
        yield line_calibrated(mhz)
        yield published("wiforce", published_mhz).transferred(mhz * 1e6, f"wiforce-{mhz}mhz")
    yield calibrated_plain_trace()


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    for sensor in all_sensors():
        write_sensor(sensor, folder / f"{sensor.name}.yaml")
