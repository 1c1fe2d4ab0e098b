# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce list`` and ``schema``: what is shipped, and the keys of its files."""

import json

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


@click.command()
@click.argument("kind", metavar="KIND", type=click.Choice(["scene", "sensor"]))
def schema(kind):
    """Print the JSON Schema of scene or sensor files.

    Editors with a YAML language server complete and check keys with it: see
    docs/reference/scenes.md.
    """
    if kind == "scene":
        from gnuradio.wiforce.scene import scene_json_schema as json_schema
    else:
        from gnuradio.wiforce.sensor.file import sensor_json_schema as json_schema
    click.echo(json.dumps(json_schema(), indent=2))
