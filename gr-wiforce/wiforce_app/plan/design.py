# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce design``: dimensions of a line to build, and settings of its tag's firmware."""

import json
from dataclasses import asdict

import click
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.sensor.microstrip import CRYSTAL_HZ, Microstrip, tag_timer

from ..shell.commands import GroupedHelp
from ..shell.options import CARRIER_HZ, FiniteRange

_PAPER = Microstrip()
# Bounds beyond which no line of a sensor lies; a strip thinner than 1 um is none.
_SIZE_MM, _PERMITTIVITY, _CLOCK_HZ = (
    FiniteRange(1e-3, 1e4),
    FiniteRange(1, 100),
    FiniteRange(1, 1e5),
)
# Heights, 2 ohm in air: the terms of the solution are as many.
_WIDEST = 200
_CRYSTAL_HZ = FiniteRange(1e5, 2e7)


@click.command(cls=GroupedHelp, examples=("design --height-mm 0.5", "design --clock-hz 1035"))
@click.option("--width-mm", type=_SIZE_MM, default=_PAPER.width_mm, help="Width of the trace.")
@click.option(
    "--height-mm", type=_SIZE_MM, default=_PAPER.height_mm, help="Distance of trace and ground."
)
@click.option("--ground-mm", type=_SIZE_MM, default=_PAPER.ground_mm, help="Width of the ground.")
@click.option("--length-mm", type=_SIZE_MM, default=_PAPER.length_mm, help="Length of the line.")
@click.option(
    "--permittivity",
    type=_PERMITTIVITY,
    default=_PAPER.permittivity,
    help="Of what fills the gap between trace and ground; 1 for air.",
)
@click.option(
    "--frequency-hz",
    "frequencies_hz",
    type=CARRIER_HZ,
    multiple=True,
    default=(900e6, 2.4e9),
    show_default=False,
    help="Carrier; may be repeated. Default: 900 MHz and 2.4 GHz.",
)
@click.option("--clock-hz", type=_CLOCK_HZ, help="Also settings of the tag's firmware for a clock.")
@click.option(
    "--crystal-hz", type=_CRYSTAL_HZ, default=CRYSTAL_HZ, help="Crystal of the tag, for --clock-hz."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON instead of text.")
def design(frequencies_hz, clock_hz, crystal_hz, as_json, **dimensions):
    """Show impedance, match and phase of a line to build, by default that of the paper.

    Trace and ground are thin strips without loss. docs/build-a-tag.md leads through the rest.
    """
    if dimensions["width_mm"] > _WIDEST * dimensions["height_mm"]:
        rule = f"must be at most {_WIDEST} times the height, beyond which lines have no use"
        raise InputError("--width-mm", rule, dimensions["width_mm"])
    line = Microstrip(**dimensions)
    report = {
        **asdict(line),
        "impedance_ohm": line.impedance_ohm,
        "effective_permittivity": line.effective_permittivity,
        "matched_height_mm": line.matched().height_mm,
        "carriers": [
            {
                "frequency_hz": hertz,
                "s11_db": float(line.reflection_db(hertz)),
                "phase_deg_per_mm": line.phase_deg_per_mm(hertz),
                "repeats_mm": 360 / line.phase_deg_per_mm(hertz),
            }
            for hertz in frequencies_hz
        ],
        "timer": None if clock_hz is None else asdict(tag_timer(clock_hz, crystal_hz)),
    }
    click.echo(json.dumps(report, indent=2) if as_json else _text(report))


def _text(found):
    lines = [
        f"line       {found['width_mm']:g} mm wide, {found['height_mm']:g} mm above a ground of "
        f"{found['ground_mm']:g} mm, {found['length_mm']:g} mm long",
        f"impedance  {found['impedance_ohm']:.1f} ohm, effective permittivity "
        f"{found['effective_permittivity']:.3g}",
        f"matched    at a height of {found['matched_height_mm']:.3g} mm, width to height "
        f"{found['width_mm'] / found['matched_height_mm']:.2f}:1, it has 50 ohm",
    ]
    for own in found["carriers"]:
        lines.append(
            f"carrier    {own['frequency_hz'] / 1e6:g} MHz: S11 {own['s11_db']:.1f} dB, "
            f"{own['phase_deg_per_mm']:.3g} deg per mm, "
            + (
                f"locations repeat every {own['repeats_mm']:.3g} mm"
                if own["repeats_mm"] < found["length_mm"]
                else "every location differs"
            )
        )
    if found["timer"]:
        timer = found["timer"]
        lines.append(
            f"firmware   SLOT={timer['steps']} PRESCALER={timer['prescaler']}: clock_hz "
            f"{timer['clock_hz']:.8g}"
        )
    return "\n".join(lines)
