# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce calibrate --surface``: how a skin spreads presses, from presses at known points."""

from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files.readings_files import ReadingsFile
from gnuradio.wiforce.io.text.textfile import check_output
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.surface import bare_skin
from gnuradio.wiforce.surface.calibration import (
    fit_spreading,
    forces_change,
    read_taps,
    surprising_taps,
)
from gnuradio.wiforce.surface.skin import borne_together, borne_too_much, write_spreading

from ..shell.log import log

# Beyond this a share is known too roughly to be of use: two neighbours then differ by as much.
_POOR_STD = 0.1
# Strips that bear less than this are not what forces in N say: a newton is 102 g.
_LEAST_BORNE = 0.1
# Four times the error of a location on a skin that nobody has calibrated (surface/skin.py):
# more than rulers and hands explain.
_POOR_LOCATION_MM = 2.0


def calibrate_surface(table, scene, readings, law, output, accept):
    """Fit a ``law`` of a scene's surface to readings of known presses, and write it.

    A table with a likely mistake is refused unless ``accept``.
    """
    if table is None or readings is None:
        missing = "TABLE" if table is None else "--readings"
        raise InputError(missing, "is missing; --surface needs a table of presses, and readings")
    scene = load_scene(scene)
    skin = bare_skin(scene)
    if skin is None:
        raise InputError("--surface", "must be a scene with a surface", str(scene.path))
    check_output(output, [table, readings, *scene.files[:1]])
    file = ReadingsFile(readings)
    taps = read_taps(table, skin, file.rows())
    if file.note:
        log.warning(f"{readings}: {file.note}")
    try:
        found, rms = fit_spreading(skin, taps, law)
    except InputError as error:
        raise InputError(table, error.rule) from None
    source = f"{len(taps)} presses of {Path(table).name}, read in {Path(readings).name}"
    found = replace(found, source=source)
    skin = replace(skin, spreading=found)
    rule = borne_too_much(skin)
    if rule:
        raise InputError(table, f"{rule}; check force_n, and the sensor files of the strips")
    suspected = list(_suspicions(skin, taps, rms))
    if suspected and not accept:
        rule = "correct it, or write the law nevertheless with --accept"
        raise InputError(table, f"{'; '.join(suspected)} ({rule})")
    write_spreading(replace(found, suspicions=tuple(suspected) or None), output)
    for text in suspected:
        click.echo(f"not to be trusted: {text}")
    _report(skin, taps, rms)
    for warning in _warnings(skin, taps, rms):
        click.echo(f"warning: {warning}")
    click.echo(f"written: {output}; name it as surface.spreading_file in the scene")


def _report(skin, taps, rms):
    """What was found, and how far it can be trusted."""
    law = skin.spreading
    shown, untouched = np.isfinite(taps.strip_force_n).sum(), taps.untouched.sum()
    click.echo(
        f"surface {skin.name}: {law.law} law from {shown} shares of touched strips and "
        f"{untouched} untouched ones"
    )
    _, together = borne_together(skin)
    click.echo(f"all strips together bear {together.min():.0%} to {together.max():.0%} of a press")
    noisy = f"rms residual {rms:.3f}, with the noise of the strips"
    click.echo(f"standard deviation of a share {law.share_std:.3f} ({noisy})")
    click.echo(f"standard deviation of the location {law.location_std_mm:.2f} mm")


def _differing(skin, rms):
    """Whether presses at one distance differ by more than strips of one law can."""
    # The residual contains the noise of the strips, and the standard deviation does not.
    return max(skin.spreading.share_std, rms) > _POOR_STD


def _warnings(skin, taps, rms):
    """What makes the law a poor one, though nothing need be wrong."""
    # Laws of one curve do not describe strips that differ, as at the edges of a skin.
    if skin.spreading.law != "strips" and _differing(skin, rms):
        yield "presses at one distance differ; --law strips gives each strip a curve of its own"
    if forces_change(taps):
        yield (
            "forces change between start_s and end_s, where more than half of the time must be of "
            "the press at force_n; share_std contains by how much"
        )


def _suspicions(skin, taps, rms):
    """What suggests that the table or the scene is wrong."""
    law = skin.spreading
    most = borne_together(skin)[1].max()
    if most < _LEAST_BORNE:
        yield f"the strips together bear at most {most:.1%} of a press; is force_n in N, not grams?"
    if law.law == "strips" and _differing(skin, rms):
        yield "presses at one distance differ; check times, forces, positions and strips"
    surprising = surprising_taps(skin, taps)
    if surprising:
        tap, most = surprising[0]
        x_mm, y_mm, strip = taps.x_mm[tap], taps.y_mm[tap], skin.strips[most]
        yield (
            f"a strip farther away bears more than the nearest one in {len(surprising)} of "
            f"{len(taps)} presses, first at x = {x_mm:g} mm, y = {y_mm:g} mm (strip "
            f"'{strip.sensor}' at y = {strip.y_mm:g} mm); check y_mm of the strips, their sensors, "
            "and the table"
        )
    off_mm = max(law.location_std_mm, *map(abs, law.location_offsets_mm))
    if off_mm > _POOR_LOCATION_MM:
        yield (
            f"strips show presses up to {off_mm:.1f} mm from their x; check x_mm and direction of "
            "the strips, and the table"
        )
