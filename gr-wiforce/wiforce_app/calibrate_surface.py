# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce calibrate --surface``: how a skin spreads presses, from presses at known points."""

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.readings_files import ReadingsFile
from gnuradio.wiforce.io.textfile import check_output
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.surface import bare_skin
from gnuradio.wiforce.surface.calibration import fit_spreading
from gnuradio.wiforce.surface.file import write_spreading
from gnuradio.wiforce.surface.taps import read_known_presses, taps_of

# Beyond this a share is known too roughly to be of use: two neighbours then differ by as much.
_POOR_STD = 0.1


def calibrate_surface(table, scene, readings, law, output):
    """Fit the spreading law of a scene's surface, and write it.

    Parameters
    ----------
    table : str
        CSV of known presses.
    scene : str
        Scene with a surface.
    readings : str or None
        Readings of a recording of these presses.
    law : str
        ``strips``, ``table`` or ``gaussian``.
    output : str
        File to write.

    Raises
    ------
    InputError
        For bad input, naming file or option, rule and value.
    """
    if table is None or readings is None:
        missing = "TABLE" if table is None else "--readings"
        raise InputError(missing, "is missing; --surface needs a table of presses, and readings")
    scene = load_scene(scene)
    skin = bare_skin(scene)
    if skin is None:
        raise InputError("--surface", "must be a scene with a surface", str(scene.path))
    check_output(output, [table, readings, *scene.files[:1]])
    presses = read_known_presses(table)
    taps = taps_of(skin, presses, ReadingsFile(readings).rows())
    try:
        fit = fit_spreading(skin, taps, law)
    except InputError as error:
        raise InputError(table, str(error).removeprefix(f"{error.where}: ")) from None
    source = f"{len(presses)} presses of {Path(table).name}, read in {Path(readings).name}"
    found = replace(fit.law, source=source)
    write_spreading(found, output)
    _report(skin, found, fit)
    click.echo(f"written: {output}; name it as surface.spreading_file in the scene")


def _report(skin, law, fit):
    """What was found, and how far it can be trusted."""
    spreading = law.spreading()
    click.echo(
        f"surface {skin.name}: {law.law} law from {fit.shares} shares of touched strips and "
        f"{fit.untouched} untouched ones"
    )
    # Where taps on and beside each strip have determined the law.
    distances = skin.spacing_mm / 2 * np.arange(-2, 3)
    own = range(len(skin.strips)) if law.law == "strips" else [0]
    click.echo("  mm across  " + "".join(f"{distance:8.1f}" for distance in distances))
    for i in own:
        name = skin.strips[i].sensor if law.law == "strips" else "each strip"
        shares = spreading.share_of(i, distances)
        click.echo(f"  {name:<11.11}" + "".join(f"{share:8.3f}" for share in shares))
    click.echo(f"standard deviation of a share {law.share_std:.3f} (fitted {fit.rms:.3f} rms)")
    click.echo(f"standard deviation of the location {law.location_std_mm:.2f} mm")
    if law.share_std > _POOR_STD:
        click.echo("warning: presses at one distance differ; check forces, positions and strips")
