# SPDX-License-Identifier: GPL-3.0-or-later
"""Tables of the documentation that ``score.py --table`` measures."""

import math
from dataclasses import dataclass

from rooms.rooms import OTHER_TRANSMITTERS, UNDETECTABLE


@dataclass(frozen=True)
class Table:
    """Rows by the name of their room, and columns by title: key of the figures and format."""

    first: str
    rows: dict
    columns: dict


TABLES = {
    "undetectable": Table(
        "what is received",
        {name: room.title for name, room in UNDETECTABLE.items()},
        {
            "flagged": ("flagged_share", "{:.0%}"),
            "force error, median / 90th (N)": ("force_median_n force_90th_n", "{:.2f} / {:.2f}"),
            "location error, median / 90th (mm)": (
                "location_median_mm location_90th_mm",
                "{:.2f} / {:.2f}",
            ),
            "wrong": ("wrong unflagged", "{} of {}"),
            "warning": ("warning", "{}"),
        },
    ),
    "interference": Table(
        "bursts of 0.3 to 2 ms, over the whole band",
        {
            "clean": "none",
            "bursts-20": "20 % of the time, 25 dB above the noise",
            "bursts-45": "45 %, 35 dB",
            **{name: room.title for name, room in OTHER_TRANSMITTERS.items()},
            "hopper": "a hopper on 8 of 64 subcarriers, 5 to 20 ms long, 50 %, 30 dB",
        },
        {
            "left out": ("rejected", "{:.0%}"),
            "phase error": ("all_phases_rms_deg", "{:.3f} deg"),
        },
    ),
}


def markdown(table, figures):
    """A table of figures by room, in the form of the documentation."""
    lines = [f"| {table.first} | {' | '.join(table.columns)} |", "|---" * (len(table.columns) + 1)]
    lines[1] += "|"
    for name, title in table.rows.items():
        own = figures[name] | {
            "flagged_share": 1 - figures[name]["read_share"],
            "warning": most_frequent(figures[name]["suspected"], figures[name]["captures"]),
        }
        cells = []
        for keys, form in table.columns.values():
            values = [own[key] for key in keys.split()]
            unknown = any(isinstance(value, float) and math.isnan(value) for value in values)
            cells.append("" if unknown else form.format(*values).replace("%", " %"))
        lines.append(f"| {title} | {' | '.join(cells)} |")
    return "\n".join(lines)


def most_frequent(suspected, captures):
    """The mistake that most captures are warned of, and how many of them."""
    kind = max(suspected, key=suspected.get, default=None)
    return "" if kind is None else f"{kind}, {suspected[kind]} of {captures}"
