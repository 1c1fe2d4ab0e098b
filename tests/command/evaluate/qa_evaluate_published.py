# SPDX-License-Identifier: GPL-3.0-or-later
"""The published trials, read with models of the VNA curves: the figures that are promised."""

import re
from pathlib import Path

import numpy as np
import pytest
from wiforce_app.evaluate import published


@pytest.fixture(scope="module")
def scores():
    return published.score_presses(published.published_presses())


def pooled(scores, frequency, method, refined=False, without_mm=None):
    """Force and location errors over all presses."""
    return published.errors(
        scores[
            (scores.freq_mhz == frequency / 1e6)
            & (scores.method == method)
            & (scores.wireless_calibration == refined)
            & (scores.location_mm != without_mm)
        ]
    )


def test_readme_states_the_errors_of_the_published_trials(scores):
    """A table that nobody can reproduce is an advertisement."""
    readme = (Path(__file__).resolve().parents[3] / "README.md").read_text(encoding="utf-8")
    (row,) = re.findall(r"^\| `evaluate paper` .*\| (.+) \| (.+) \|$", readme, re.MULTILINE)
    found = [np.median(np.abs(error)) for error in pooled(scores, 900e6, "single reading")]
    here, paper = ([float(number) for number in re.findall(r"[\d.]+", cell)] for cell in row)
    assert here == pytest.approx(found, abs=0.006)
    assert tuple(paper) == published.CLAIMS[900e6]


def test_results_page_states_the_errors_of_the_published_trials(scores):
    """Each line of 'the paper, ours, why' must be what its command prints."""
    page = (Path(__file__).resolve().parents[3] / "docs" / "results.md").read_text(encoding="utf-8")

    def medians(method, what=0, **selected):
        return tuple(
            float(np.median(pooled(scores, frequency, method, **selected)[what]))
            for frequency in published.FREQUENCIES_HZ
        )

    single, known, whole = map(medians, ("single reading", "location known", "smoother"))
    near, far = zip(single, known, whole, strict=True)
    for stated in (
        "{:.2f} N singly, {:.2f} N with known location, {:.2f} N for whole presses".format(*near),
        "{:.2f}, {:.2f} and {:.2f} N; simulated".format(*far),
        "{:.2f} and {:.2f} mm singly".format(*medians("single reading", 1)),
        "medians are {:.2f} and {:.2f} N".format(*medians("single reading", without_mm=40.0)),
        f"2.4 GHz to {medians('smoother', refined=True)[1]:.2f} N for whole presses",
    ):
        assert stated in page


def test_fourteen_presses_are_different_and_trial_3_is_scored_alone():
    """A repeated press would count twice; one that was learnt from would flatter the models."""
    presses = published.published_presses()
    assert len(presses) == 14 and sum(p.force_n.size for p in presses) == 2 * (121 + 142)
    for i, press in enumerate(presses):
        for other in presses[:i]:
            assert not set(press.force_n) & set(other.force_n) or (
                press.location_mm[0],
                press.frequency_hz[0],
            ) != (other.location_mm[0], other.frequency_hz[0])
    assert "3" not in published.LEARNT_FROM.values() and "3" in published.LEARNT_FROM
    assert all(trial != other for trial, other in published.LEARNT_FROM.items())


def test_no_reading_at_40_mm_claims_better_than_it_is(scores):
    own = scores[(scores.location_mm == 40) & (scores.method == "single reading")]
    for _, press in own.groupby(["freq_mhz", "wireless_calibration", "trial"]):
        force, _ = published.errors(press)
        assert np.mean(force <= 2 * press.force_std_n) >= 0.9
        if not press.wireless_calibration.any():
            assert press["flags"].str.contains("force-unobservable").mean() >= 0.9
