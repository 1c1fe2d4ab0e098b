#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes the tables of keys in docs/scenes.md and docs/sensor-files.md from their declarations.

    build/run python3 docs/make_schema_tables.py

A table stands between the lines `<!-- keys: NAME -->` and `<!-- end of keys -->`.
"""

import dataclasses
import re
from pathlib import Path

from gnuradio.wiforce.io.schema import ListOf, Mapping, keys
from gnuradio.wiforce.scene import Scene
from gnuradio.wiforce.scene.effects import OtherTag
from gnuradio.wiforce.scene.simulated import Move, Press, Simulation
from gnuradio.wiforce.scene.simulated_tags import Tag
from gnuradio.wiforce.sensor.file_schema import CarrierCurves, CurvesFile, LineFile, SensorFile

DOCS = Path(__file__).resolve().parent
PAGES = (DOCS / "scenes.md", DOCS / "sensor-files.md")
_TABLE = re.compile(r"(<!-- keys: (.+?) -->\n).*?(<!-- end of keys -->)", re.S)


def rows_of(cls, leave_out=(), prefix=""):
    """Table rows of a declared mapping and of those in it, with dotted keys."""
    for name, each in keys(cls).items():
        if name in leave_out:
            continue
        if isinstance(each.type, Mapping):
            if each.type.optional:
                yield _row(f"{prefix}{name}", each)
            yield from rows_of(each.type.of, prefix=f"{prefix}{name}.")
        elif isinstance(each.type, ListOf):
            yield from rows_of(each.type.of, prefix=f"{prefix}{name}[].")
        else:
            yield _row(f"{prefix}{name}", each)


def _row(dotted, each):
    cells = (f"`{dotted}`", _default(each), _allowed(each.type), each.doc)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _default(key):
    if key.derived:
        return key.derived.text
    if key.default is dataclasses.MISSING:
        return "required"
    value = key.type.plain(key.default)
    if isinstance(value, str):
        return f"`{value}`"
    if isinstance(value, int | float):
        return f"{value:g}" if abs(value) < 1e5 else f"{value / 1e6:g}e6"
    return "null" if value is None else str(value)


def _allowed(value_type):
    text = value_type.rule.removeprefix("must be ")
    return re.sub(r"(?<=\d)e\+?(-?)0*(\d)", r"e\1\2", text)


TABLES = {
    "reader": [*rows_of(Scene, leave_out={"simulation"})],
    "simulation": [*rows_of(Simulation, leave_out={"tags", "other_tags", "presses", "moves"})],
    "presses": [*rows_of(Press)],
    "tags": [*rows_of(Tag)],
    "other tags": [*rows_of(OtherTag)],
    "moves": [*rows_of(Move)],
    "every sensor": [*rows_of(SensorFile)],
    "line": [*rows_of(LineFile, leave_out=keys(SensorFile))],
    "curves": [*rows_of(CurvesFile, leave_out={*keys(SensorFile), "carriers"})],
    "carriers": [*rows_of(CarrierCurves)],
}


def page(path):
    """A page with its tables as the declarations say."""

    def table(match):
        head = ("| key | default | allowed | meaning |", "|---|---|---|---|")
        return "\n".join([match[1], *head, *TABLES[match[2]], "", match[3]])

    return _TABLE.sub(table, path.read_text(encoding="utf-8"))


def main():
    for path in PAGES:
        path.write_text(page(path), encoding="utf-8")


if __name__ == "__main__":
    main()
