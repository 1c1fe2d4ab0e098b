# SPDX-License-Identifier: GPL-3.0-or-later
"""Many scenes as experiments: run in parallel, stored, resumed, reported."""

import json
from pathlib import Path

import click
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.text.textfile import check_output, write_whole
from gnuradio.wiforce.scene import load_scene, sampled_scenes, simulation_warnings

from ..shell.log import log
from ..shell.progress import progress
from ..shell.provenance import fingerprint
from ..shell.workers import run_tasks
from .causes import other_causes, paper_figures
from .report import cause_table, table, write_report

# Of the stored results; those of another one are computed again.
_FORMAT = 4


def evaluate_scenes(names, folder, jobs=None, fresh=False, scheduler=None):
    """Run the scenes without a stored result, and write ``report.md`` and a picture per scene.

    ``names``: scenes; ``all`` means every shipped scene of samples; ``fresh``: compute stored
    results again.
    """
    if "all" in names:
        names = sampled_scenes()
    names = list(dict.fromkeys(names))
    stems = [Path(name).stem for name in names]
    for name, stem in zip(names, stems, strict=True):
        if stems.count(stem) > 1:
            raise InputError("scenes", "must have different file names", name)
    # Invalid scenes are refused before any work is done.
    for name in names:
        if load_scene(name).packets is not None:
            raise InputError(name, "is a scene of packets; only scenes of samples are evaluated")
    fingerprints = {
        name: fingerprint(load_scene(name), other_causes(str(name)), _FORMAT, simulated=True)
        for name in names
    }
    inputs = [file for name in names for file in load_scene(name).files]
    for name in names:
        for warning in simulation_warnings(load_scene(name)):
            log.warning(f"{name}: {warning}")
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        for output in (_file(folder, name), _file(folder, name).with_suffix(".png")):
            check_output(output, inputs)
    check_output(folder / "report.md", inputs)
    missing = [
        name for name in names if fresh or result_of(folder, name, fingerprints[name]) is None
    ]
    # A worker of a cluster has another working folder.
    tasks = [(name, _findable(name), str(folder.absolute())) for name in missing]
    with progress("evaluating", len(missing)) as step:
        for outcome in run_tasks(_run, tasks, jobs, scheduler):
            name = missing[outcome.index]
            keep_result(folder, name, fingerprints[name], outcome.get())
            step(1)
    results = [result_of(folder, name, fingerprints[name]) for name in names]
    figures = paper_figures()
    write_report(results, folder, figures)
    click.echo(table(results, figures))
    if causes := cause_table(results, figures):
        click.echo(f"\n{causes}")
    click.echo(f"\nreport: {folder / 'report.md'}")


def _findable(name):
    return str(Path(name).absolute()) if Path(name).is_file() else name


def _run(task):
    from .experiment import run

    name, *where = task
    return {**run(*where), "scene": str(name)}


def _file(folder, name):
    return folder / f"{Path(name).stem}.json"


def result_of(folder, name, current):
    """The stored result of a scene; None when there is none with this hash."""
    try:
        content = json.loads(_file(folder, name).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return content["result"] if content.get("fingerprint") == current else None


def keep_result(folder, name, current, result):
    """Write a result atomically."""
    write_whole(_file(folder, name), json.dumps({"fingerprint": current, "result": result}))
