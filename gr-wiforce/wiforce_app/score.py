# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce score``: readings compared with the record of a force gauge."""

import csv
import io
import json
from pathlib import Path

import click
import numpy as np
from gnuradio.wiforce.errors import InputError, unwritable
from gnuradio.wiforce.io.readings_files import ReadingsFile
from gnuradio.wiforce.io.textfile import check_output, write_whole
from gnuradio.wiforce.sensor.gauge_comparison import TimedForces, compare_with_gauge
from gnuradio.wiforce.sensor.gauge_file import read_gauge_file

from .options import FiniteRange, Number, capture_scene, sample_type

_READINGS = (".csv", ".jsonl", ".parquet")
_COLUMNS = ("time_s", "force_n", "force_std_n", "gauge_n", "error_n")


@click.command()
@click.argument("capture", type=click.Path())
@click.option(
    "--against", required=True, type=click.Path(), help="CSV file of the gauge or load cell."
)
@capture_scene
@sample_type
@click.option("--sensor", help="Name of the sensor that was pressed, where there are several.")
@click.option("--time-column", help="Name of the gauge's column of times.")
@click.option("--force-column", help="Name of the gauge's column of forces.")
@click.option("--unit", help="Unit of the gauge's forces: N, mN, g, kg, lb or oz.")
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
    show_default=True,
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
    sensor,
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
    if plot_path is not None:
        from .plots import check_picture

        check_picture(plot_path, inputs)
    gauge = read_gauge_file(against, time_column, force_column, unit)
    readings = _forces(capture, scene_path, datatype, sensor)
    try:
        found = compare_with_gauge(readings, gauge, touch_force, offset)
    except InputError as error:
        raise error.renamed({"gauge": str(against), "readings": str(capture)}) from None
    if output is not None:
        _write(output, found)
    report = _report(found)
    click.echo(json.dumps(report, indent=1) if as_json else _text(report))
    if plot_path is not None:
        from .score_plot import plot_comparison

        plot_comparison(readings, gauge, found, plot_path, f"{capture} against {against}")


def _forces(capture, scene_path, datatype, sensor):
    """Forces of one sensor, from a file of readings or from a capture that is read now."""
    path = Path(capture)
    if path.suffix.lower() in _READINGS and datatype is None:
        if scene_path is not None:
            raise click.UsageError("--scene is for captures; a file of readings needs none")
        rows = list(ReadingsFile(path).rows())
    else:
        from gnuradio.wiforce.io.capture import open_capture
        from gnuradio.wiforce.scene import scene_of

        from .captures.recordings import read_capture

        rows = []
        recording = open_capture(capture, datatype)
        scene, _ = scene_of(recording, scene_path)
        read_capture(recording, scene, lambda reading: rows.append(reading.row()), None)
    names = sorted({row["sensor"] for row in rows})
    if not names:
        raise InputError(capture, "holds no readings")
    if sensor is None and len(names) != 1:
        raise InputError("--sensor", f"must be one of {', '.join(names)}")
    if sensor is not None and sensor not in names:
        raise InputError("--sensor", f"must be one of {', '.join(names)}", sensor)
    own = [row for row in rows if sensor in (None, row["sensor"])]
    times = _column(own, "time_s")
    if not np.all(np.diff(times) > 0):
        first = times[1:][np.diff(times) <= 0][0]
        raise InputError(capture, "time_s must increase: score one run at a time", first)
    touched = np.array([row["touch"] == 1 for row in own])
    known = np.array([row["touch"] is not None for row in own])
    force = np.where(touched, _column(own, "force_n"), 0.0)
    return TimedForces(
        times,
        np.where(known, force, np.nan),
        _column(own, "force_std_n"),
        touched,
        known & np.isfinite(force) & np.array([not row["flags"] for row in own]),
    )


def _column(rows, name):
    return np.array([np.nan if row[name] is None else row[name] for row in rows], float)


def _report(found):
    """Plain values, rounded to what they mean."""
    error = np.abs(found.error_n)
    return {
        "offset_s": round(found.offset_s, 4),
        "offset_std_s": round(found.offset_std_s, 4),
        "other_offset_s": found.other_offset_s,
        "correlation": round(found.correlation, 4),
        "gauge_sign": found.sign,
        "gauge_zero_n": round(found.zero_n, 4),
        "compared": len(error),
        "median_error_n": round(float(np.median(error)), 4),
        "rms_error_n": round(float(np.sqrt(np.mean(error**2))), 4),
        "p90_error_n": round(float(np.quantile(error, 0.9)), 4),
        "bias_n": round(float(np.mean(found.error_n)), 4),
        "gain": round(found.gain, 4),
        "within_2_std": round(found.coverage, 4),
        "flagged": found.flagged,
        "missed": found.missed,
        "false": found.false,
        "unrecorded": found.unrecorded,
    }


def _text(report):
    lines = [
        f"offset          {report['offset_s']:.4f} +- {report['offset_std_s']:.4f} s (time of the "
        f"gauge at time 0 of the readings; correlation {report['correlation']:.3f})",
        f"gauge           zero {report['gauge_zero_n']:.3f} N, subtracted"
        + ("; presses are negative, sign inverted" if report["gauge_sign"] < 0 else ""),
        f"compared        {report['compared']} steady touched readings without flag",
        f"force error     median {report['median_error_n']:.3f} N, rms {report['rms_error_n']:.3f}"
        f" N, 90 % below {report['p90_error_n']:.3f} N, bias {report['bias_n']:+.3f} N",
        f"gain            {report['gain']:.3f} N read per N of the gauge",
        f"within 2 std    {report['within_2_std']:.0%} (95 % expected; the gauge's own error counts"
        " as the reading's)",
        f"not compared    {report['flagged']} flagged, {report['missed']} missed (clear, but read "
        f"as untouched), {report['false']} touched while the gauge shows no press, "
        f"{report['unrecorded']} where the gauge's record has a hole",
    ]
    if report["other_offset_s"] is not None:
        lines.append(
            f"ambiguous       an offset of {report['other_offset_s']:.2f} s fits nearly as well: "
            "the presses repeat; state the right one with --offset"
        )
    return "\n".join(lines)


def _write(path, found):
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    columns = (getattr(found, name) for name in _COLUMNS)
    for time_s, *values in zip(*columns, strict=True):
        writer.writerow([round(float(time_s), 9), *(f"{value:.4f}" for value in values)])
    try:
        write_whole(path, text.getvalue())
    except OSError as error:
        raise unwritable(path, error) from error
