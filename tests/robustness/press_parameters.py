# SPDX-License-Identifier: GPL-3.0-or-later
"""What half and twice each parameter of the press filter do to random sequences, as a table.

build/run python3 tests/robustness/press_parameters.py > docs/data/press_parameters.csv
"""

import csv
import sys
from functools import partial

from gnuradio.wiforce.press.explanations import filter_of
from gnuradio.wiforce.receiver import receiver
from gnuradio.wiforce.wiforce_kernels import press_parameters
from sequence_readings import score

# What the caller knows and states, and no expectation.
STATED = "period_s", "smoothing_s", "drift_deg", "turns_per_s"
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
    for name in press_parameters.dtype.names:
        if name in STATED:
            continue
        value = press_parameters[name][0]
        for factor in (0.5, 2):
            write([name, f"{factor * value:g}", *row_of(**{name: factor * value})])
            sys.stdout.flush()


if __name__ == "__main__":
    main()
