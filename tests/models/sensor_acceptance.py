# SPDX-License-Identifier: GPL-3.0-or-later
"""Accuracy of calibrated models at locations that were not calibrated, in full.

    build/run python3 tests/models/sensor_acceptance.py [CALIBRATIONS]

Contact laws of which the package knows nothing (three smooth ones, two with kinks), 0.2 deg
calibration noise, five locations; pressed between them with 0.1 deg phase noise. Many calibrations,
since each has its own errors.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import read_vna_csv
from sensor_laws import LAWS, PRESSED_MM, OwnLaw, read_law, vna_rows

FREQUENCIES_HZ = (900e6, 2400e6)


def main(calibrations=12):
    laws = (*LAWS, OwnLaw("power", "kinked", 12.0), OwnLaw("power", "straight", 5.0))
    heads = "".join(f"{f'{location:g} mm':>14}" for location in PRESSED_MM)
    print(f"{'law, carrier':34}{'median':>14}{heads}{'in 2 sigma F, l':>32}")
    for law in laws:
        for frequency in FREQUENCIES_HZ:
            read = {seed: _one(law, frequency, seed) for seed in range(calibrations)}
            _print(law, frequency, pd.concat(read, names=["calibration"]))


def _one(law, frequency, seed):
    rng = np.random.default_rng(seed)
    rows = vna_rows(law, frequency, np.linspace(2, 8, 30), 0.2, rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vna.csv"
        path.write_text("\n".join(rows) + "\n")
        model = calibrate(read_vna_csv(path), "own")
    return read_law(model, law, frequency, 300, 0.1, rng)


def _print(law, frequency, read):
    places = [read, *(read[read["at_mm"] == location] for location in PRESSED_MM)]
    cells = [f"{p['force_n'].median():.3f} / {p['location_mm'].median():.3f}" for p in places]
    label = f"{law.reach}, {law.fade} over {law.fade_mm:g} mm, {frequency / 1e6:g} MHz"
    # Mean over the calibrations and its standard error: one calibration's readings err alike.
    inside = 100 * read.groupby("calibration")[["force_inside", "location_inside"]].mean()
    error = inside.std(ddof=0) / np.sqrt(len(inside))
    cover = ", ".join(f"{inside[name].mean():.1f} +- {error[name]:.1f} %" for name in inside)
    print(f"{label:34}" + "".join(f"{cell:>14}" for cell in cells) + f"{cover:>32}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
