# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce list``: shipped scenes and sensor models."""

import click
from gnuradio.wiforce.scene.load import about_scene, shipped_scenes
from gnuradio.wiforce.sensor import load_sensor, shipped_sensors


@click.command()
@click.argument(
    "what", metavar="[scenes|sensors]", type=click.Choice(["scenes", "sensors"]), required=False
)
def list(what):
    """List shipped scenes and sensor models. Every command accepts these names."""
    if what != "sensors":
        click.echo("scenes")
        for name in shipped_scenes():
            first_sentence = about_scene(name).partition(". ")[0].rstrip(".")
            click.echo(f"  {name:<31}{first_sentence}")
    if what != "scenes":
        click.echo("sensors")
        for name in shipped_sensors():
            click.echo(f"  {name:<31}{load_sensor(name).provenance['source']}")
