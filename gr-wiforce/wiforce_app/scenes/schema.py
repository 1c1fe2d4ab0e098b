# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce schema``: the JSON Schema of scene and sensor files, for editors."""

import json

import click


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
