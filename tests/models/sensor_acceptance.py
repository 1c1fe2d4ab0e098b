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
            results = [_one(law, frequency, seed) for seed in range(calibrations)]
            _print(law, frequency, results)


def _one(law, frequency, seed):
    rng = np.random.default_rng(seed)
    rows = vna_rows(law, frequency, np.linspace(2, 8, 30), 0.2, rng)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "vna.csv"
        path.write_text("\n".join(rows) + "\n")
        model = calibrate(read_vna_csv(path), "own")
    return read_law(model, law, frequency, 300, 0.1, rng)


def _print(law, frequency, results):
    def pair(pick):
        force = np.median(np.concatenate([pick(r.force_error) for r in results]))
        place = np.median(np.concatenate([pick(r.location_error) for r in results]))
        return f"{force:.3f} / {place:.3f}"

    cells = [pair(lambda errors: np.concatenate(list(errors.values())))]
    cells += [pair(lambda errors, at=at: errors[at]) for at in PRESSED_MM]
    label = f"{law.reach}, {law.fade} over {law.fade_mm:g} mm, {frequency / 1e6:g} MHz"
    cover = ", ".join(_coverage(results, what) for what in ("force", "location"))
    print(f"{label:34}" + "".join(f"{cell:>14}" for cell in cells) + f"{cover:>32}")


def _coverage(results, what):
    """Mean over the calibrations and its standard error: one calibration's readings err alike."""
    parts = [100 * result.coverage(what) for result in results]
    return f"{np.mean(parts):.1f} +- {np.std(parts) / np.sqrt(len(parts)):.1f} %"


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
