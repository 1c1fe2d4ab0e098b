# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce list``, ``schema``, ``simulate``: shipped scenes, their keys and captures."""

import dataclasses
import json

import click

from ..shell.commands import GroupedHelp
from ..shell.log import log, progress
from ..shell.options import IntegerRange, scene_names


@click.command()
@click.argument(
    "what", metavar="[scenes|sensors]", type=click.Choice(["scenes", "sensors"]), required=False
)
def list(what):
    """List shipped scenes and sensor models. Every command accepts these names."""
    from gnuradio.wiforce.scene.load import about_scene, shipped_scenes
    from gnuradio.wiforce.sensor import load_sensor, shipped_sensors

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


@click.command(
    cls=GroupedHelp, examples=("simulate demo press", "simulate scene.yaml press --seed 7")
)
@click.argument("scene", metavar="SCENE.yaml", shell_complete=scene_names)
@click.argument("name", metavar="NAME")
@click.option(
    "--datatype",
    type=click.Choice(["ci16_le", "cf32_le"]),
    default="ci16_le",
    help="Samples as 16-bit integers, as from a USRP, or as floats.",
)
@click.option(
    "--seed",
    type=IntegerRange(0, 2**63 - 1),
    help="Seed of all random numbers. Default: that of the scene.",
)
@click.option("--force", is_flag=True, help="Replace existing files.")
def simulate(scene, name, datatype, seed, force):
    """Simulate a scene: write the capture NAME.sigmf-data and NAME.sigmf-meta, and the applied
    presses as NAME.truth.csv. Of a scene with packets, write their channels as NAME.npz."""
    from gnuradio.wiforce.planning.plan import plan
    from gnuradio.wiforce.scene import load_scene, simulation_warnings
    from gnuradio.wiforce.simulation import simulator
    from gnuradio.wiforce.simulation.truth import frame_count, group_centers

    scene = load_scene(scene)
    if seed is not None:
        simulation = dataclasses.replace(scene.simulation, seed=seed)
        scene = dataclasses.replace(scene, simulation=simulation)
    plan(scene)  # what cannot be read is refused before it is simulated
    settings, steps = scene.simulation, frame_count(scene)
    duration_s = steps * scene.snapshot_period_s
    if scene.packets is None:
        steps *= scene.sounding.frame_length * scene.environment.receive_antennas
    with progress("simulating", steps) as done:
        paths = simulator.simulate(scene, name, datatype, done, force, "--force")
    for path in paths:
        click.echo(path)
    for warning in simulation_warnings(scene):
        log.warning(warning)
    presses = len(settings.presses) + len(settings.surface_presses)
    log.info(
        f"{duration_s:.3g} s, phase groups: {len(group_centers(scene))}, "
        f"presses: {presses}, moves: {len(settings.moves)}, seed: {settings.seed}"
    )
