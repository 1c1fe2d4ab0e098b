# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce demo``: calibrate a line, simulate presses, read them, compare with the truth."""

from importlib.util import find_spec
from pathlib import Path

import click
import numpy as np
import yaml
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import measure_vna, read_vna_csv, write_vna_csv
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.files.writers import open_writer
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.sensor import load_sensor, write_sensor
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.simulation.truth import frame_count, read_truth, score

from ..read.recordings import read_capture
from ..shell.log import progress
from ..shell.plots import plot_readings

_LOCATIONS_MM = (20.0, 30.0, 40.0, 50.0, 60.0)
_FORCES_N = np.arange(1.0, 8.1, 0.25)
_CALIBRATION_NOISE_DEG = 0.2
# Median errors that the demo must reach to succeed.
_FORCE_LIMIT_N = 0.15
_LOCATION_LIMIT_MM = 0.3

_SHOWN_EACH = 3  # of the readings, one of so many is printed, as the heading says

# Files in the folder; the scene's first line marks those of an earlier demo.
_FILES = (
    "scene.yaml",
    "vna.csv",
    "sensor.yaml",
    "demo.sigmf-data",
    "demo.sigmf-meta",
    "demo.truth.csv",
    "readings.csv",
    "readings.png",
)
_MARK = "# Written by gr-wiforce demo, which replaces the files of this folder when run again.\n"


@click.command()
@click.option(
    "--folder",
    type=click.Path(file_okay=False),
    default="demo",
    help="Where files are written. Files that are not from an earlier demo are not replaced.",
)
def demo(folder):
    """Simulate two presses, read them back through GNU Radio and compare with the truth.

    Where GNU Radio is not installed, the library reads the capture. The exit status is 1 when the
    errors are larger than promised.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    _check_folder(folder)
    shipped = Path(DATA_DIR) / "scenes" / "demo.yaml"
    line = load_sensor(load_scene(shipped).simulation.tags[0].truth_model)
    # First of all files: it marks the folder as that of a demo, even of one that is interrupted.
    path = _write_scene(shipped, folder)
    click.echo(
        f"1. calibrate {line.name} at {len(_LOCATIONS_MM)} locations from simulated VNA data"
    )
    _calibrate(line, folder)
    scene = load_scene(path)
    click.echo(f"2. simulate {scene.simulation.duration_s:g} s of received signal")
    samples = frame_count(scene) * scene.sounding.frame_length
    with progress("simulating", samples) as step:
        simulate(scene, folder / "demo", progress=step, overwrite=True)
    has_gnuradio = find_spec("gnuradio.wiforce.wiforce_python") is not None
    click.echo(f"3. read the capture {'through' if has_gnuradio else 'without'} GNU Radio")
    if has_gnuradio:
        readings = _flowgraph_readings(folder / "demo", scene)
    else:
        readings = read_capture(open_capture(folder / "demo"), scene)
    with open_writer(folder / "readings.csv") as writer:
        writer.write_all(readings)
    truth = read_truth(folder / "demo.truth.csv")
    _show(readings, truth)
    title = "gr-wiforce demo: readings and truth"
    plot_readings(readings, folder / "readings.png", title, truth, line.length_mm)
    result = score(readings, truth, scene.sensors[0].name)
    click.echo(
        f"\nmedian error over {len(result.force_error_n)} touched groups: "
        f"force {result.median_force_n:.3f} N (limit {_FORCE_LIMIT_N}), "
        f"location {result.median_location_mm:.3f} mm (limit {_LOCATION_LIMIT_MM})"
    )
    click.echo(f"picture of all readings: {folder / 'readings.png'}")
    kept = result.median_force_n <= _FORCE_LIMIT_N
    return 0 if kept and result.median_location_mm <= _LOCATION_LIMIT_MM else 1


def _check_folder(folder):
    """Refuse a folder with files of the demo's names that no earlier demo has written."""
    scene = folder / _FILES[0]
    if scene.is_file() and scene.read_bytes().startswith(_MARK.encode()):
        return
    for path in (folder / name for name in _FILES):
        if path.exists():
            rule = "exists already and is not from an earlier demo; name another --folder"
            raise InputError(path, rule)


def _calibrate(line, folder):
    table = measure_vna(line, _LOCATIONS_MM, _FORCES_N, _CALIBRATION_NOISE_DEG, seed=1)
    write_vna_csv(table, folder / "vna.csv")
    model = calibrate(read_vna_csv(folder / "vna.csv"), "demo", length_mm=line.length_mm)
    write_sensor(model, folder / "sensor.yaml")


def _write_scene(shipped, folder):
    """Write the shipped scene with the sensor model that will be calibrated; give its path."""
    content = yaml.safe_load(shipped.read_text(encoding="utf-8"))
    for sensor in content["sensors"]:
        sensor["model"] = "sensor.yaml"
    path = folder / _FILES[0]
    path.write_text(_MARK + yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def _flowgraph_readings(capture, scene):
    from gnuradio import gr, wiforce

    readings = []
    flowgraph = gr.top_block("gr-wiforce demo", catch_exceptions=False)
    source = wiforce.capture_source(capture, scene)
    reader = wiforce.reader(scene, input_type="folded", on_reading=readings.append)
    flowgraph.connect(source, reader)
    flowgraph.run()
    if reader.failure is not None:
        raise reader.failure
    return readings


def _show(readings, truth):
    """Print every third touched reading without a flag."""
    rows = {(round(row["time_s"], 4), row["sensor"]): row for row in truth}
    click.echo(
        "\none reading in three of those touched and without a flag; +-: two standard deviations"
    )
    click.echo("     time (s)      force (N)  truth     location (mm)  truth")
    for each in [each for each in readings if each.touch and not each.flags][::_SHOWN_EACH]:
        row = rows[(round(each.time_s, 4), each.sensor)]
        click.echo(
            f"  {each.time_s:14.3f}   {each.force_n:5.2f} +-{2 * each.force_std_n:4.2f}"
            f" {row['force_n']:6.2f}   {each.location_mm:6.2f} +-{2 * each.location_std_mm:4.2f}"
            f" {row['location_mm']:6.2f}"
        )
