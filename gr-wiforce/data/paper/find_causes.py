# SPDX-License-Identifier: GPL-3.0-or-later
"""Finds how strong a cause must be for the paper's method to measure what the paper published.

build/run python3 gr-wiforce/data/paper/find_causes.py [SCENE...]

Rewrites ``causes.yaml`` and the tag in the file of each scene. Only the paper's method is run: no
level depends on what this receiver reads.
"""

import re
import sys
import tempfile
from pathlib import Path

import numpy as np
import yaml
from gnuradio.wiforce.scene import load_scene
from wiforce_app.evaluate.experiment import (
    OWN,
    paper_changes,
    paper_errors,
    simulated,
    with_cause,
)
from wiforce_app.evaluate.published import paper_figures

HERE = Path(__file__).resolve().parent
SCENES = HERE.parent.parent / "scenes"
# What is fitted: the published quantity of each experiment.
FITTED = {
    "distance_20cm": "phase_rms_deg",
    "distance_50cm": "phase_rms_deg",
    "distance_1m": "phase_rms_deg",
    "distance_2m": "phase_rms_deg",
    "paper_900": "force_n",
    "paper_2400": "force_n",
}
CLOSE, MOST_TRIALS = 0.03, 12
# Presses over which random walks are fitted, since each takes its own course. Of several captures,
# that which is nearest to all of them together is evaluated.
PRESSES = 4


def pushed(scene, distance_mm):
    """Every press pushes the sensor away; it comes back with the release."""
    moves = []
    for press in scene.simulation.presses:
        for start_s, way in ((press.start_s, 1), (press.end_s - press.rise_s, -1)):
            moves.append(
                {
                    "sensor": press.sensor,
                    "start_s": round(start_s, 6),
                    "duration_s": press.rise_s,
                    "distance_mm": way * distance_mm,
                }
            )
    return {"moves": moves}


# By cause: keys of ``simulation`` for an amplitude, and the amplitude to begin with.
CAUSES = {
    OWN: (lambda scene, x: {"tags": [{"clock_period_jitter_s": digits(1e-9 * x)}]}, 15),
    "drift": (lambda scene, x: {"tags": [{"drift_deg_per_sqrt_s": digits(x)}]}, 1),
    "bursts": (lambda scene, x: {"bursts": {"share": 0.2, "level_db": decibels(x)}}, 100),
    "movers": (
        lambda scene, x: {"moving_clutter_db": decibels(x), "moving_clutter_hz": 30.0}, 8,
    ),
    "mechanics": (lambda scene, x: pushed(scene, digits(x)), 0.5),
}  # fmt: skip


RANDOM_WALKS = (OWN, "drift")


def digits(value):
    return float(f"{value:.3g}")


def decibels(amplitude):
    return round(float(20 * np.log10(amplitude)), 1)


def papers_error(scene, key, folder):
    """Error of the paper's method in a scene."""
    with simulated(scene, folder) as (recording, truth):
        changes = paper_changes(recording, scene)
    return paper_errors(scene, 0, changes, truth, detrend=True)[key]


def fitted(name, cause, wanted, folder):
    """Keys of ``simulation`` with which the paper's method gives the wanted error."""
    scene, key = load_scene(name), FITTED[name]
    change_of, amplitude = CAUSES[cause]
    captures = PRESSES // len(scene.simulation.presses) if cause in RANDOM_WALKS else 1
    first = 100 * list(FITTED).index(name)
    seeds = range(first, first + captures)
    below, above = None, None  # the nearest amplitudes with too little and too much error
    best = np.inf, {}  # a median jumps from one group's error to another's
    for _ in range(MOST_TRIALS):
        changes = [change_of(scene, amplitude) | {"seed": seed} for seed in seeds]
        errors = [papers_error(with_cause(scene, change), key, folder) for change in changes]
        error = float(np.sqrt(np.mean(np.square(errors))))
        print(f"  {cause} {amplitude:.4g}: {error:.4g}", flush=True)
        off = abs(np.log(error / wanted))
        if off < best[0]:
            best = off, changes[int(np.argmin(np.abs(np.array(errors) - wanted)))]
        if off < CLOSE:
            break
        if error < wanted:
            below = amplitude, error
        else:
            above = amplitude, error
        amplitude = _next(amplitude, error, wanted, below, above)
    return best[1]


def _next(amplitude, error, wanted, below, above):
    """Amplitude by interpolation of logarithms, or in proportion where one side is not known."""
    if below is None or above is None:
        return amplitude * float(np.clip(wanted / error, 0.2, 5.0))
    (low, less), (high, more) = below, above
    part = np.clip(np.log(wanted / less) / np.log(more / less), 0.1, 0.9)
    return float(low * (high / low) ** part)


def main(names):
    path = HERE / "causes.yaml"
    with tempfile.TemporaryDirectory() as folder:
        for name in names:
            wanted = paper_figures()[name][FITTED[name]]
            print(f"{name}: {FITTED[name]} {wanted:.3g}", flush=True)
            causes = {cause: fitted(name, cause, wanted, folder) for cause in CAUSES}
            _write_own(SCENES / f"{name}.yaml", causes.pop(OWN))
            _write_others(path, name, causes)


ABOUT = (
    "Disturbances with each of which the paper's method measures what the paper published, by",
    f"scene: keys of `simulation` that replace the {OWN} in the scene's file. Made by",
    "find_causes.py.",
)


def _write_own(path, change):
    """Put the cause that a scene itself holds into its file."""
    text = path.read_text(encoding="utf-8")
    tag = f"  tags: [{{clock_period_jitter_s: {change['tags'][0]['clock_period_jitter_s']:.3g}}}]\n"
    text = re.sub(r"^  tags: .*\n", "", text, flags=re.MULTILINE)
    text = re.sub(r"^  seed: .*$", f"  seed: {change['seed']}", text, flags=re.MULTILINE)
    path.write_text(text.replace("  presses:\n", tag + "  presses:\n"), encoding="utf-8")


def _write_others(path, name, causes):
    """Put the other causes of a scene into ``causes.yaml``, below those of the scenes before it."""
    found = yaml.safe_load(path.read_text(encoding="utf-8")) or {}
    found[name] = causes
    found = {name: found[name] for name in FITTED if name in found}
    body = yaml.safe_dump(found, sort_keys=False, default_flow_style=None, width=120)
    head = "".join(f"# {line}\n" for line in ABOUT)
    path.write_text(head + body, encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:] or FITTED)
