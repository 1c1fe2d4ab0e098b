# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce score``: readings compared with the record of a force gauge."""

import json
from pathlib import Path

import click
from gnuradio.wiforce.calibration.gauge_comparison import compare_with_gauge, timed_forces
from gnuradio.wiforce.calibration.gauges import UNITS, read_gauge
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.files import format_of
from gnuradio.wiforce.io.files.readings_files import ReadingsFile
from gnuradio.wiforce.io.palette import TRUTH, series_style
from gnuradio.wiforce.io.text.textfile import check_output, write_csv

from ..shell.commands import GroupedHelp
from ..shell.log import log
from ..shell.options import FiniteRange, Number, capture_scene, sample_type
from ..shell.plots import check_picture, save_picture

_COLUMNS = ("time_s", "force_n", "force_std_n", "gauge_n", "error_n")


@click.command(cls=GroupedHelp, examples=("score press --against gauge.csv",))
@click.argument("capture", type=click.Path())
@click.option(
    "--against", required=True, type=click.Path(), help="CSV file of the gauge or load cell."
)
@capture_scene
@sample_type
@click.option(
    "--sensor",
    "sensors",
    multiple=True,
    help="Name of the sensor that was pressed, where there are several. Given more than once, the "
    "forces of these sensors are added: one gauge bears them all.",
)
@click.option("--time-column", help="Name of the gauge's column of times.")
@click.option("--force-column", help="Name of the gauge's column of forces.")
@click.option("--unit", help=f"Unit of the gauge's forces: {UNITS}.")
@click.option(
    "--offset",
    type=Number(),
    metavar="SECONDS",
    help="Time of the gauge at time 0 of the capture. Default: estimated.",
)
@click.option(
    "--touch-force",
    type=FiniteRange(0, min_open=True),
    default=0.5,
    metavar="NEWTONS",
    help="Force of the gauge from which the sensor must read a touch.",
)
@click.option("-o", "--output", type=click.Path(), help="Write each force compared (CSV).")
@click.option("--plot", "plot_path", type=click.Path(), help="Write a picture (PNG, PDF or SVG).")
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def score(
    capture,
    against,
    scene_path,
    datatype,
    sensors,
    time_column,
    force_column,
    unit,
    offset,
    touch_force,
    output,
    plot_path,
    as_json,
):
    """Compare the readings of a CAPTURE, or of a file of readings, with a force gauge.

    The gauge may have any clock, zero and sign: the offset in time is estimated from the presses,
    and what the gauge shows while the sensor is untouched is subtracted. Its gain is not changed.
    """
    inputs = [capture, against]
    if output is not None:
        check_output(output, inputs)
    check_picture(plot_path, inputs)
    gauge = read_gauge(against, time_column, force_column, unit)
    if gauge.note:
        log.warning(f"{against}: {gauge.note}")
    rows = _rows(capture, scene_path, datatype)
    try:
        readings = timed_forces(rows, sensors or None)
        found = compare_with_gauge(readings, gauge, touch_force, offset)
    except InputError as error:
        names = {"gauge": str(against), "readings": str(capture), "sensor": "--sensor"}
        raise error.renamed(names) from None
    if output is not None:
        _write(output, found)
    click.echo(json.dumps(found.report(), indent=1) if as_json else str(found))
    if plot_path is not None:
        _plot_comparison(readings, gauge, found, plot_path, f"{capture} against {against}")


def _rows(capture, scene_path, datatype):
    """Readings of a file, or of a capture that is read now."""
    path = Path(capture)
    if format_of(path) is not None and datatype is None:
        if scene_path is not None:
            raise click.UsageError("--scene is for captures; a file of readings needs none")
        file = ReadingsFile(path)
        rows = list(file.rows())
        if file.note:
            log.warning(f"{path}: {file.note}")
    else:
        from gnuradio.wiforce.io.capture import open_capture
        from gnuradio.wiforce.scene import scene_of

        from ..read.recordings import read_capture

        recording = open_capture(capture, datatype)
        scene, _ = scene_of(recording, scene_path)
        rows = [reading.row() for reading in read_capture(recording, scene, None)]
    return rows


def _write(path, found):
    import pandas

    frame = pandas.DataFrame({name: getattr(found, name) for name in _COLUMNS})
    # Times are joined with those of other files.
    frame["time_s"] = frame["time_s"].round(9).astype(str)
    write_csv(path, frame)


def _plot_comparison(readings, gauge, found, path, title):
    """Draw both forces, and the errors, over time."""
    from gnuradio.wiforce.receiver.plotting import legend_beside
    from matplotlib.figure import Figure

    canvas = Figure(figsize=(11, 6), layout="constrained")
    canvas.suptitle(title, fontsize=11)
    forces, errors = canvas.subplots(2, 1, height_ratios=(3, 2), sharex=True)
    gauge_n = found.sign * (gauge.force_n - found.zero_n)
    forces.plot(gauge.time_s - found.offset_s, gauge_n, color=TRUTH, lw=3, label="gauge")
    style = {"ls": "", "ms": 2.5, **series_style(0)}
    for chosen, more in (
        (readings.clear, {"label": "reading"}),
        (readings.touched & ~readings.clear, {"label": "flagged, not compared", "marker": "x"}),
    ):
        forces.plot(readings.time_s[chosen], readings.force_n[chosen], **{**style, **more})
    forces.set_xlim(*readings.time_s[[0, -1]])
    forces.set_ylabel("force (N)")
    legend_beside(forces)
    errors.errorbar(found.time_s, found.error_n, 2 * found.force_std_n, lw=0.7, **style)
    errors.axhline(0, color=TRUTH, lw=1)
    errors.set_ylabel("reading - gauge (N)\nbars: 2 std")
    errors.set_xlabel("time (s)")
    for axis in (forces, errors):
        axis.grid(alpha=0.3)
    save_picture(canvas, path)
