# SPDX-License-Identifier: GPL-3.0-or-later
"""The published trials, read with models of the VNA curves: the figures that are promised."""

import re
from pathlib import Path

import numpy as np
import pytest
from gnuradio.wiforce._config import DATA_DIR
from gnuradio.wiforce.calibration.tables import read_vna_csv
from gnuradio.wiforce.errors import InputError
from wiforce_app.evaluate import published
from wiforce_app.evaluate.evaluate import evaluate

FOLDER = Path(DATA_DIR) / "data" / "paper"
# The form that cross-validation on the VNA curves chooses; a test below holds that it does.
FORM = "power"


@pytest.fixture(scope="module")
def scores():
    presses = published.read_presses(FOLDER / "wireless.csv")
    return published.score_presses(FOLDER / "vna.csv", presses, forms=(FORM,))


def pooled(scores, frequency, method, refined=False):
    """Force and location errors over all presses."""
    own = [
        s
        for s in scores
        if (s.press.frequency_hz, s.method, s.refined) == (frequency, method, refined)
    ]
    return tuple(
        np.concatenate([getattr(s, what) for s in own])
        for what in ("force_error", "location_error")
    )


def test_readme_states_the_errors_of_the_published_trials(scores):
    """A table that nobody can reproduce is an advertisement."""
    readme = (Path(__file__).resolve().parents[3] / "README.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"^\| `evaluate paper` .*\| (.+) \| (.+) \|$", readme, re.MULTILINE)
    found = [np.median(np.abs(error)) for error in pooled(scores, 900e6, "single reading")]
    here, paper = ([float(number) for number in re.findall(r"[\d.]+", cell)] for cell in row)
    assert here == pytest.approx(found, abs=0.006)
    assert tuple(paper) == published.CLAIMS[900e6]


@pytest.mark.parametrize("frequency", published.FREQUENCIES_HZ)
def test_the_form_is_chosen_without_the_trials(frequency):
    assert published.chosen_form(read_vna_csv(FOLDER / "vna.csv", frequency)) == FORM


@pytest.mark.parametrize("frequency, count, limit", [(900e6, 90, 0.57), (2400e6, 98, 0.40)])
def test_force_at_a_known_location(scores, frequency, count, limit):
    force, _ = pooled(scores, frequency, "location known")
    assert force.size == count and np.median(force) <= limit


@pytest.mark.parametrize("frequency, force_90, place_50", [(900e6, 2.3, 0.35), (2400e6, 1.4, 0.6)])
def test_force_and_place_together_by_the_causal_tracker(scores, frequency, force_90, place_50):
    force, place = pooled(scores, frequency, "causal tracker")
    assert np.quantile(force, 0.9) <= force_90 and np.median(place) <= place_50


def test_one_wireless_press_per_location_helps(scores):
    force, place = pooled(scores, 2400e6, "causal tracker", refined=True)
    assert np.median(force) <= 0.35 and np.median(place) <= 0.3


def test_no_reading_at_40_mm_claims_better_than_it_is(scores):
    own = [s for s in scores if s.press.location_mm == 40 and s.method == "single reading"]
    for score in own:
        assert np.mean(score.force_error <= 2 * score.force_std_n) >= 0.9
        if not score.refined:
            flagged = ["force-unobservable" in flags for flags in score.flags]
            assert np.mean(flagged) >= 0.9


def test_a_trial_is_never_scored_with_what_was_learnt_from_it(monkeypatch):
    """Every model that reads a trial is refined, and its scatter measured, on the other only."""
    presses = [
        p
        for p in published.read_presses(FOLDER / "wireless.csv")
        if p.frequency_hz == 900e6 and p.location_mm == 20
    ]
    learnt = []
    refine, scatter = published.refine, published._scatter
    monkeypatch.setattr(published, "FREQUENCIES_HZ", (900e6,))

    def spied_refine(model, table):
        learnt.append(set(table.press))
        return refine(model, table)

    def spied_scatter(model, others):
        learnt.append({press.trial for press in others})
        return scatter(model, others)

    monkeypatch.setattr(published, "refine", spied_refine)
    monkeypatch.setattr(published, "_scatter", spied_scatter)
    scores = published.score_presses(FOLDER / "vna.csv", presses, forms=(FORM,))
    read = [score.press.trial for score in scores[:: len(published.METHODS)]]
    assert read == ["1", "1", "2", "2"] and learnt == [{"2"}, {"2"}, {"1"}, {"1"}]


def test_the_bootstrap_interval_holds_the_median():
    rng = np.random.default_rng(1)
    errors = [np.abs(rng.normal(0, 1, 20)) for _ in range(6)]
    low, high = published.bootstrap_median(errors)
    assert low < np.median(np.concatenate(errors)) < high
    assert (low, high) == published.bootstrap_median(errors)


def test_a_place_that_cannot_be_written_is_refused_before_the_work(monkeypatch, tmp_path):
    def scored(*arguments):
        raise AssertionError("worked for nothing")

    monkeypatch.setattr(published, "score_presses", scored)
    for path in (tmp_path / "absent" / "scores.csv", tmp_path):
        with pytest.raises(InputError, match=f"^{path}: "):
            evaluate.main(["paper", "-o", str(path)], standalone_mode=False)
