# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce transfer``: a sensor model at another carrier than that of its calibration."""

from pathlib import Path

import click
from gnuradio.wiforce.io.text.textfile import check_output

from ..shell.commands import GroupedHelp
from ..shell.options import CARRIER_HZ, sensor_names, sensor_output


@click.command(
    cls=GroupedHelp, examples=("transfer arm.yaml --frequency-hz 915e6 -o arm-915.yaml",)
)
@click.argument("sensor", shell_complete=sensor_names)
@click.option("--frequency-hz", type=CARRIER_HZ, required=True, help="The new carrier.")
@sensor_output
@click.option("--name", help="Name of the sensor; the output's name by default.")
def transfer(sensor, frequency_hz, output, name):
    """Transfer a SENSOR, shipped or a file, to a carrier within 10 % of its own.

    Contact positions in millimetres stay as they are and phases scale with frequency. Connectors
    follow no such rule: the file states the uncertainty that this adds to every phase.
    """
    from gnuradio.wiforce.sensor import load_sensor, write_sensor

    check_output(output, [sensor])
    moved = load_sensor(sensor).transferred(frequency_hz, name or Path(output).stem)
    write_sensor(moved, output)
    added = moved.transfer_std_deg
    click.echo(
        f"sensor {moved.name}: {frequency_hz / 1e6:g} MHz, "
        + (
            "evaluated by physics, no uncertainty added"
            if added is None
            else f"calibrated at {moved.transferred_from_hz / 1e6:g} MHz, {added:.2g} deg added to "
            "the standard deviation of each phase"
        )
    )
    click.echo(f"written: {output}")
