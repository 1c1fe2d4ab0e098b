# SPDX-License-Identifier: GPL-3.0-or-later
"""What half and twice each parameter of the press filter do to random sequences, as a table.

build/run python3 tests/robustness/press_parameters.py > docs/data/press_parameters.csv
"""

import csv
import sys
from functools import partial

from gnuradio.wiforce.press.explanations import filter_of
from gnuradio.wiforce.receiver import receiver
from sequence_readings import score

# As in lib/kernel/press/press_parameters.h.
DEFAULTS = {
    "settling_s": 0.3,
    "release": 0.4,
    "exchange": 0.1,
    "jump": 0.1,
    "unexplained": 0.02,
    "change_s": 0.03,
    "steady_s": 0.5,
    "turns": 3e-4,
    "turns_s": 10.0,
    "turn_deg": 15.0,
    "turn_np": 0.1,
    "hands": 0.3,
    "near_s": 0.5,
    "steps": 0.003,
    "contact_np": 0.05,
    "aside": 0.1,
    "phase_deg": 0.03,
    "amplitude_np": 0.003,
    "fading_np": 0.01,
    "drift_memory_s": 20.0,
}
RUNS = ((125, 6), (2500, 24))
FAMILIES = "plain", "mixture", "carrier"


def row_of(**changed):
    """Shares read of steady touched and untouched groups, and wrong readings, per group length."""
    receiver.filter_of = lambda *sensor, **given: filter_of(*sensor, **given | changed)
    row = []
    for snapshots, sequences in RUNS:
        found = [score(range(sequences), snapshots, family) for family in FAMILIES]
        for what in ("pressed", "untouched"):
            read = sum(each.counts[f"{what}, read"] for each in found)
            row.append(f"{100 * read / sum(each.counts[what] for each in found):.1f}")
        row += [sum(len(each.wrong) for each in found)]
        row += [sum(each.counts["unflagged"] for each in found)]
    return row


def main():
    write = partial(csv.writer(sys.stdout, lineterminator="\n").writerow)
    columns = "read_pressed_percent", "read_untouched_percent", "wrong", "of_unflagged"
    write(["parameter", "value", *(f"{name}_{n}" for n, _ in RUNS for name in columns)])
    write(["all", "as stated", *row_of()])
    for name, value in DEFAULTS.items():
        for factor in (0.5, 2):
            write([name, f"{factor * value:g}", *row_of(**{name: factor * value})])
            sys.stdout.flush()


if __name__ == "__main__":
    main()
