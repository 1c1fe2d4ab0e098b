# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce plan``: what a scene needs computed, what that costs, what to expect of it."""

import dataclasses
import json

import click
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.scene.advice import improve as proposals_for
from gnuradio.wiforce.scene.advice import warnings as warnings_of
from gnuradio.wiforce.scene.expected import expect
from gnuradio.wiforce.scene.plan import plan as plan_of
from gnuradio.wiforce.scene.steps import steps as steps_of


@click.command()
@click.argument("scene", metavar="SCENE.yaml")
@click.option("--improve", is_flag=True, help="Propose better parameters, and what each brings.")
@click.option("--json", "as_json", is_flag=True, help="For other programs.")
def plan(scene, improve, as_json):
    """Say which steps a SCENE needs, what each costs, and which errors to expect.

    Noise, clutter and presses are those of the scene's simulation section.
    """
    scene = load_scene(scene)
    settings = plan_of(scene)
    report = {
        "settings": _settings(settings),
        "steps": [dataclasses.asdict(step) for step in steps_of(scene, settings)],
        "expected": [dataclasses.asdict(sensor) for sensor in expect(scene, settings)],
        "warnings": list(warnings_of(scene, settings)),
    }
    if improve:
        report["proposals"] = [dataclasses.asdict(p) for p in proposals_for(scene, settings)]
    if as_json:
        click.echo(json.dumps(report, indent=2))
    else:
        _print(report, scene)


def _settings(settings):
    return {
        "waveform": settings.waveform.name,
        "snapshot_rate_hz": 1 / settings.waveform.snapshot_period_s,
        "group_length": settings.group_length,
        "group_period_s": settings.group_period_s,
        "clutter_hz": settings.clutter_hz,
        "harmonics": settings.harmonics,
        "tones": len(settings.table.tones),
        "reference_groups": settings.reference_groups,
        "smoothing_groups": settings.smoothing_groups,
        "estimator": settings.estimator,
        "loss_db": list(settings.loss_db),
    }


def _print(report, scene):
    chosen = report["settings"]
    click.echo(
        f"{chosen['snapshot_rate_hz']:.0f} snapshots/s, groups of {chosen['group_length']} "
        f"({1e3 * chosen['group_period_s']:.1f} ms), lines +-1..+-{chosen['harmonics']} of each "
        f"tag in {chosen['tones']} tones, estimator {chosen['estimator']}"
    )
    click.echo("\nstep                        needed   Mflop/s  why")
    for step in report["steps"]:
        cost = step["operations"] / 1e6
        click.echo(
            f"{step['name']:<27} {'yes' if step['needed'] else 'skipped':<8}"
            f"{cost:8.3g}  {step['reason']}"
        )
    needed = sum(step["operations"] for step in report["steps"] if step["needed"])
    saved = sum(step["operations"] for step in report["steps"] if not step["needed"])
    click.echo(f"in all {needed / 1e6:.3g} Mflop per second of signal; {saved / 1e6:.3g} skipped")
    click.echo(f"\nexpected at snr_db {scene.simulation.snr_db:g} (medians)")
    for sensor in report["expected"]:
        error, std = sensor["phase_error_deg"], sensor["phase_std_deg"]
        if error is None:
            click.echo(f"{sensor['sensor']}: not readable")
            continue
        click.echo(
            f"{sensor['sensor']}: phases {error[0]:.3g}/{error[1]:.3g} deg "
            f"(noise {std[0]:.3g}/{std[1]:.3g} rms), force {sensor['force_error_n']:.3g} N, "
            f"location {sensor['location_error_mm']:.3g} mm"
        )
    for warning in report["warnings"]:
        click.echo(f"warning: {warning}")
    for proposal in report.get("proposals", ()):
        std, time = proposal["phase_std_deg"], proposal["time_resolution_s"]
        click.echo(
            f"better: {proposal['change']}: {proposal['reason']} (noise {std[0]:.3g} -> "
            f"{std[1]:.3g} deg, a reading in {1e3 * time[0]:.3g} -> {1e3 * time[1]:.3g} ms)"
        )
    if "proposals" in report and not report["proposals"]:
        click.echo("nothing better found")
