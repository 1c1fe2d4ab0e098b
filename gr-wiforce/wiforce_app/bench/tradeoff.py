# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce bench tradeoff``: run time against error, for every scene and sensible setting."""

import json
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import click
from gnuradio.wiforce.io.textfile import check_output

from ..progress import progress
from .front import beat_the_plan, front

_RUNS, _QUICK_RUNS = 2, 1


@click.command()
@click.argument("scenes", nargs=-1)
@click.option("--json", "as_json", is_flag=True, help="Points as JSON instead of a table.")
@click.option("--quick", is_flag=True, help="Each setting timed once instead of twice.")
@click.option(
    "--folder",
    type=click.Path(file_okay=False),
    default="tradeoff",
    show_default=True,
    help="Results by scene; what is there already is not measured again.",
)
@click.option("--fresh", is_flag=True, help="Measure everything again.")
@click.option("--plot", "plot_path", type=click.Path(), help="Picture of all scenes, PNG.")
@click.option("--page", "page_path", type=click.Path(), help="The table as a page, Markdown.")
def tradeoff(scenes, as_json, quick, folder, fresh, plot_path, page_path):
    """Run time per second of signal against phase and force error of SCENES, all shipped if none.

    Settings beside the plan's: group length, lines, clutter band, estimator (the paper's too),
    subcarriers, sample type, file or stream, order of the blocks, stock blocks. Processor time.
    """
    from gnuradio.wiforce.scene import shipped_scenes

    from ..evaluation.runs import keep_result, mark_of, result_of

    if plot_path is not None:
        from ..plots import check_picture

        check_picture(plot_path)
    if page_path is not None:
        check_output(page_path)
    names = list(dict.fromkeys(scenes or shipped_scenes()))
    marks = {name: mark_of(name) for name in names}  # refuses bad scenes before anything is done
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    results = {name: None if fresh else result_of(folder, name, marks[name]) for name in names}
    missing = [name for name in names if results[name] is None]
    with progress("measuring", len(missing)) as step:
        for name in missing:
            results[name] = _measured(name, folder, _QUICK_RUNS if quick else _RUNS)
            keep_result(folder, name, marks[name], results[name])
            step(1)
    results = [results[name] for name in names]
    if plot_path is not None:
        from .picture import plot_tradeoffs

        plot_tradeoffs(results, plot_path)
    if page_path is not None:
        Path(page_path).write_text(_page(results, scenes, plot_path, page_path), encoding="utf-8")
    if as_json:
        click.echo(json.dumps({"scenes": results}, indent=1))
    else:
        click.echo(f"{table(results)}\n\n{skip_table(results)}")


def _measured(name, folder, runs):
    """A scene's result, from a process of its own: memory and caches are as for any other."""
    from .tradeoff_points import measure_scene

    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        return pool.submit(measure_scene, name, folder, runs).result()


_HEAD = (
    "scene", "setting", "ms per s", "samples", "groups", "readings/s", "phase (deg)", "bound",
    "force (N)", "location (mm)", "front",
)  # fmt: skip


def table(results):
    """Markdown: a row per scene and setting; medians of the errors, milliseconds of processor."""
    rows = [_HEAD, ["---"] * len(_HEAD)]
    for result in results:
        points = result["points"]
        kept = [point["setting"] for point in front(points)]
        for point in points:
            rows.append(_row(result, point, point["setting"] in kept))
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([*lines, "", *_verdicts(results)])


def _verdicts(results):
    """What beats the plan's choice, with and without regard to how many readings it gives."""
    for told, any_length in (("", False), (", at other rates of readings", True)):
        found = {Path(r["scene"]).stem: beat_the_plan(r["points"], any_length) for r in results}
        beaten = [f"{scene} by {', '.join(names)}" for scene, names in found.items() if names]
        yield (
            "20 % faster and 20 % more accurate in phase than the plan's choice"
            f"{told}: {'; '.join(beaten) or 'nothing'}.\n"
        )


def skip_table(results):
    """Markdown: milliseconds of processor per second of signal that each skip saves."""
    names = list(dict.fromkeys(name for result in results for name in result["skips"]))
    rows = [["scene", *names], ["---"] * (1 + len(names))]
    for result in results:
        times = [result["skips"].get(name) for name in names]
        shown = ["" if t is None else f"{1e3 * t:.2g}" for t in times]
        rows.append([Path(result["scene"]).stem, *shown])
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def _row(result, point, on_front):
    times = [1e3 * point[key] for key in ("cpu_s_per_s", "samples_s_per_s", "groups_s_per_s")]
    errors = [point[key] for key in ("phase_deg", "bound_deg", "force_n", "location_mm")]
    return [
        Path(result["scene"]).stem if point["setting"] == "plan" else "",
        point["setting"],
        *(f"{value:.1f}" for value in times),
        f"{point['readings_per_s']:.0f}",
        *("" if value is None else f"{value:.3g}" for value in errors),
        "yes" if on_front else "",
    ]


_EXPLANATION = """\
Each scene is simulated once and read under each setting: samples to tones by the C++ blocks (or
stock ones), tones to readings by what the reader's Python blocks compute. Times are processor time
for a second of signal at the scene's rate, in milliseconds, and its two parts, the least of some
runs: tens of per cent apart on a busy machine. Errors are medians over steadily touched groups of
all sensors, of some tens of readings each: 20 % apart by chance. Phase errors leave out what the
calibration errs by in the untouched phases, and the bound (a median too) is that of the setting's
own groups. *Front*: no other setting is both faster and more accurate in phase. The number of
readings a second is the scene's to say, not the plan's: errors of longer groups are taken to the
scene's group length.
`stock blocks` are GNU Radio's own in place of ours, buffers tuned; `block by block` folds and makes
tones in a block each; `channel first` is the textbook order; `paper` adds up steps from group to
group at lines 1 and 4, its clock not tracked.
""".splitlines()

_SKIPS = """\
Milliseconds of processor per second of signal that the reader's blocks would take more with the
step forced on; the readings stay the same (`tests/qa_reader.py`).
""".splitlines()


def _page(results, scenes, plot_path, page_path):
    command = " ".join(["gr-wiforce bench tradeoff", *scenes])
    command += f" --plot {plot_path}" if plot_path else ""
    picture = [] if plot_path is None else [f"![Run time against error]({_beside(plot_path)})", ""]
    head = ["# Run time against error", "", f"Made by `{command} --page {page_path}`.", ""]
    skips = ["", "## What each skip saves", "", *_SKIPS, "", skip_table(results), ""]
    return "\n".join([*head, *_EXPLANATION, "", *picture, table(results), *skips])


def _beside(plot_path):
    """The picture as a page in docs/ names it."""
    path = Path(plot_path)
    return f"{path.parent.name}/{path.name}" if path.parent.name == "images" else path.name
