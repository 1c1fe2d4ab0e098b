# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the shipped sensors: build/run python3 gr-wiforce/sensors/make_sensors.py [FOLDER]"""

import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import measure_vna, read_vna_csv
from gnuradio.wiforce.sensor import LineModel, write_sensor
from gnuradio.wiforce.sensor.line import ContactLaw

HERE = Path(__file__).resolve().parent
PUBLISHED = HERE.parent / "data" / "paper" / "vna.csv"
FREQUENCIES_MHZ = (900, 2400)
# In the middle of the bands at 902-928 MHz and 2400-2483.5 MHz; each from the paper's carrier.
UNLICENSED_MHZ = {915: 900, 2440: 2400}
DATE = "2026-11-21"
# Just under the least published force.
ONSET_FORCE_N = 0.9
CONTACT = ContactLaw(decay_length_mm=3.95, asymmetry=0.68, fade_mm=7.0)

FORCES_N = np.arange(0.5, 8.1, 0.25)
FINGER_WIDTH_MM = 18.0
STAMP_WIDTH_MM = 16.0
STIFF_MM = 0.02


def line(mhz):
    """The physical line, pressed in simulations."""
    return LineModel(
        name=f"line-{mhz}mhz",
        length_mm=80.0,
        frequencies_hz=(mhz * 1e6,),
        onset_force_n=ONSET_FORCE_N,
        force_span_n=(ONSET_FORCE_N, 10.0),
        location_span_mm=(15.0, 65.0),
        permittivity=1.0,
        port_offset_deg=(0.0, 0.0),
        contact=CONTACT,
        provenance={
            "source": "physics: a soft beam on an elastic foundation over a line in air "
            "(python/wiforce/sensor/line.py)",
            "date": DATE,
            "assumed": [
                "over 2-8 N the short moves 4.8 mm on the near end and 1.0 mm on the far end, and "
                "2.9 mm in the middle: not a fit (docs/sensors.md, what is measured)",
                "how sharply the ends change over in the middle is not published",
            ],
        },
    )


def line_calibrated(mhz):
    """A model of the physical line, from a simulated VNA with noise."""
    table = measure_vna(line(mhz), (20, 30, 40, 50, 60), FORCES_N, noise_deg=0.2, seed=mhz)
    return calibrate(
        table,
        f"line-{mhz}mhz-calibrated",
        source=f"a VNA's sweep of line-{mhz}mhz, simulated: 0.5 to 8 N at 20, 30, 40, 50 and 60 mm "
        f"with 0.2 deg of noise (measure_vna, seed {mhz})",
        date=DATE,
    )


def pressed_widely(name, mhz, width_mm):
    """The line under something wide: the same beam, loaded evenly over its width."""
    half = width_mm / 2 / CONTACT.decay_length_mm
    # What touches the line at ONSET_FORCE_N at a point bends it by less when it is spread.
    deflection = (1 - np.exp(-half) * np.cos(half)) / half
    onset = round(ONSET_FORCE_N / deflection, 3)
    return replace(
        line(mhz),
        name=name,
        onset_force_n=onset,
        force_span_n=(onset, 10.0),
        contact=replace(CONTACT, width_mm=width_mm),
        provenance={
            "source": f"physics: line-{mhz}mhz pressed evenly over {width_mm:g} mm",
            "date": DATE,
            "assumed": ["the contact is as wide at all forces"],
        },
    )


def calibrated_stamp(mhz):
    """A calibration for fingertips, made with a flat stamp a little narrower than a finger."""
    stamp, seed = pressed_widely("stamp", mhz, STAMP_WIDTH_MM), mhz + 2
    table = measure_vna(stamp, (20, 30, 40, 50, 60), FORCES_N, noise_deg=0.2, seed=seed)
    return calibrate(
        table,
        f"fingertip-{mhz}mhz-calibrated",
        source=f"a VNA's sweep of line-{mhz}mhz pressed with a stamp {STAMP_WIDTH_MM:g} mm wide, "
        f"simulated as that of line-{mhz}mhz (seed {seed})",
        date=DATE,
    )


def plain_trace():
    """A line without the soft beam: what presses it shorts it in one place, however hard."""
    contact = replace(CONTACT, decay_length_mm=STIFF_MM)
    return replace(
        line(900),
        name="plain-trace-900mhz",
        contact=contact,
        provenance={
            "source": "physics: a bare trace over ground, shorted where it is pressed; the short "
            "hardly widens with force",
            "date": DATE,
            "assumed": [f"the short widens by {STIFF_MM * np.pi:.2f} mm at most"],
        },
    )


def calibrated_plain_trace():
    """What a calibration makes of the plain trace: curves that are flat against force."""
    table = measure_vna(plain_trace(), (20, 30, 40, 50, 60), FORCES_N, noise_deg=0.2, seed=901)
    return calibrate(
        table,
        "plain-trace-900mhz-calibrated",
        source="a VNA's sweep of plain-trace-900mhz, simulated as that of line-900mhz (seed 901)",
        date=DATE,
    )


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
    """Every shipped sensor."""
    for mhz in FREQUENCIES_MHZ:
        yield line(mhz)
        yield line_calibrated(mhz)
        yield published("paper", mhz)
        yield published("wiforce", mhz)
    for mhz, published_mhz in UNLICENSED_MHZ.items():
        yield line(mhz)
        yield line_calibrated(mhz)
        yield published("wiforce", published_mhz).transferred(mhz * 1e6, f"wiforce-{mhz}mhz")
    for mhz in FREQUENCIES_MHZ:
        yield pressed_widely(f"fingertip-{mhz}mhz", mhz, FINGER_WIDTH_MM)
        yield calibrated_stamp(mhz)
    yield plain_trace()
    yield calibrated_plain_trace()


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE
    for sensor in all_sensors():
        write_sensor(sensor, folder / f"{sensor.name}.yaml")
