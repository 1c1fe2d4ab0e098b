# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole presses show mistakes that no single reading shows."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import read_vna_csv
from gnuradio.wiforce.io.readings import Flag
from gnuradio.wiforce.press.evidence import PressEvidence
from gnuradio.wiforce.wiforce_kernels import group_reading
from second_simulator import CARRIER_HZ, Line, Tag, phases, write_vna

PERIOD_S = 0.036
STD_DEG = 0.04
# Forces of a press, group by group; locations.
PRESS = np.r_[np.zeros(8), np.linspace(2.0, 6.5, 24), np.zeros(4)]
PLACES_MM = (33.0, 54.0)


@pytest.fixture(scope="module", params=[Line(), Line(lean=0.2)], ids=["even", "leaning"])
def sensor(request, tmp_path_factory):
    """A line, and its model as calibrated from a VNA table."""
    table = tmp_path_factory.mktemp("sensor") / "finger.csv"
    write_vna(Tag(line=request.param), table, np.random.default_rng(1))
    return request.param, calibrate(read_vna_csv(table), "finger")


def presses(line, slide_mm=0.0, off=0.0, contact=1.0):
    """Ratios of two presses, (G, 2), and touch; the location slides while the force rises."""
    force = np.tile(PRESS, len(PLACES_MM))
    place = np.repeat(PLACES_MM, len(PRESS)) + slide_mm * force / PRESS.max()
    psi = phases(Tag(line=line), np.r_[0.0, force], np.r_[40.0, place])
    size = np.where(np.r_[0.0, force] > 0, contact, 1.0)[:, None]
    reflections = size * np.exp(1j * np.radians(psi)) - off
    ratios = reflections[1:] / reflections[0]
    noise = np.random.default_rng(2).standard_normal((2, *ratios.shape))
    return ratios * np.exp(np.radians(STD_DEG) * (noise[0] + 1j * noise[1])), (force > 0).astype(
        int
    )


def rows_of(ratios, psi, touch, clear=True, flags=0, unexplained=False):
    """What groups say: ratios, phases and touch, as the kernel gives them."""
    read = np.zeros(len(touch), group_reading)
    columns = {"level": ratios, "phases_deg": psi, "psi_std_deg": STD_DEG, "touch": touch}
    stated = {"clear": clear, "flags": flags, "unexplained": unexplained}
    for name, values in {**columns, **stated}.items():
        read[name] = values
    return read


def judged(model, ratios, touch, batch=None, period_s=PERIOD_S):
    """The evidence of some groups, and which of them they contradict."""
    evidence = PressEvidence(model, CARRIER_HZ, np.zeros(2), period_s)
    psi = np.array(model.untouched_deg(CARRIER_HZ)) + np.degrees(np.angle(ratios))
    read = rows_of(ratios, psi, touch)
    batch = batch or len(touch)
    found = [evidence.take(read[i : i + batch]) for i in range(0, len(touch), batch)]
    return evidence, np.concatenate(found)


@pytest.mark.parametrize(("contact", "kinds"), [(1.0, []), (0.98, []), (0.9, ["amplitude"])])
def test_evidence_right_file_is_not_suspected(sensor, contact, kinds):
    """A warning that comes with the right file is no warning; contacts lose some of the signal."""
    line, model = sensor
    evidence, contradicting = judged(model, *presses(line, contact=contact))
    assert [each.kind for each in evidence.suspicions] == kinds and not contradicting.any()


def test_evidence_edges_of_a_press_are_excluded(sensor):
    """In its first and last group a press is a mixture with the untouched sensor."""
    line, model = sensor
    ratios, touch = presses(line)
    edges = (touch == 1) & ((np.roll(touch, 1) == 0) | (np.roll(touch, -1) == 0))
    ratios[edges] *= 0.3
    evidence, _ = judged(model, ratios, touch)
    assert edges.sum() == 4 and evidence.suspicions == []


def test_evidence_swapped_ends_are_found_where_the_line_is_not_even(sensor):
    """All locations would be mirrored without any other sign."""
    line, model = sensor
    ratios, touch = presses(replace(line, swapped=True))
    evidence, contradicting = judged(model, ratios, touch)
    found = [each.kind for each in evidence.suspicions]
    assert found == (["swapped ends"] if line.lean else [])
    assert evidence.contradicted == bool(line.lean)
    # From the second press on nothing is known before its end.
    assert not contradicting[:-4].any()
    more = np.concatenate([ratios, ratios]), np.tile(touch, 2)
    whole = judged(model, *more)[1]
    assert np.array_equal(whole, judged(model, *more, batch=7)[1])
    assert np.array_equal(whole, (np.arange(len(more[1])) >= 72) & (more[1] == 1) & bool(line.lean))


@pytest.mark.parametrize("times", [0.25, 5])
@pytest.mark.parametrize(("lasts_s", "found"), [(0.9, ["swapped ends"]), (0.15, [])])
def test_evidence_needs_presses_that_last_as_long_in_groups_of_any_length(
    sensor, times, lasts_s, found
):
    """Six readings last 40 ms or 0.9 s: short groups were judged by taps, long ones hardly ever."""
    line, model = sensor
    ratios, touch = presses(replace(line, swapped=True))
    untouched = np.arange(8)
    pressed = np.linspace(8, 31, round(times * lasts_s / PERIOD_S)).astype(int)
    at = np.r_[untouched, pressed, untouched]
    at = np.r_[at, at + len(PRESS)]
    evidence, _ = judged(model, ratios[at], touch[at], period_s=PERIOD_S / times)
    assert [each.kind for each in evidence.suspicions] == (found if line.lean else [])


def test_evidence_other_file_moves_locations_with_the_force(sensor):
    line, model = sensor
    other = Line(lean=0.0 if line.lean else 0.2)
    evidence, contradicting = judged(model, *presses(other))
    (found,) = evidence.suspicions
    assert (
        found.text.startswith("the location moves with the force, by 0.")
        and not contradicting.any()
    )


def test_evidence_sliding_contact_is_not_taken_for_swapped_ends(sensor):
    """Readings of a finger that slides are right."""
    line, model = sensor
    evidence, contradicting = judged(model, *presses(line, slide_mm=2.0))
    (found,) = evidence.suspicions
    assert "the contact slides" in found.text and not contradicting.any()


@pytest.mark.parametrize(("off", "expected"), [(0.03, 0), (0.2, 2)])
def test_evidence_unstated_off_state_shows_in_the_amplitude(sensor, off, expected):
    line, model = sensor
    evidence, _ = judged(model, *presses(line, off=off * np.exp(0.5j)))
    found = [each for each in evidence.suspicions if each.kind == "off state"]
    assert len(found) == expected and evidence.contradicted == bool(expected)
    assert all("changes as with an off state of 0.2" in each.text for each in found)
    evidence.reset()
    assert evidence.suspicions == [] and not evidence.contradicted


def test_evidence_phases_of_no_press_cast_suspicion_on_the_file(sensor):
    line, model = sensor
    evidence = PressEvidence(model, CARRIER_HZ, np.zeros(2), PERIOD_S)
    ratios, touch = presses(line)
    flags = Flag.EXTRAPOLATED.value
    evidence.take(rows_of(ratios, 0, touch, True, flags))
    assert evidence.suspicions[0].text.startswith("48 of 48 touched readings have phases that no ")
    # A press that the filter cannot explain is flagged, and says the same.
    evidence.reset()
    evidence.take(rows_of(ratios, 0, touch, False, Flag.INCONSISTENT.value, touch == 1))
    assert evidence.suspicions[0].text.startswith("48 of 48 touched readings have phases that no ")
    # What other stages flag says nothing of the file.
    evidence.reset()
    evidence.take(rows_of(ratios, 0, touch, False, flags))
    assert evidence.suspicions == []


def test_evidence_of_a_press_of_hours_is_bounded_and_finds_the_same(sensor):
    """A gripper that holds an object for a day must not fill the memory."""
    line, model = sensor
    ratios, touch = presses(replace(line, swapped=True))
    ratios, touch = np.repeat(ratios, 500, axis=0), np.repeat(touch, 500)
    tracemalloc.start()
    evidence, _ = judged(model, ratios[:14_000], touch[:14_000], batch=500)  # inside a press
    kept = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert kept < 2e6  # 10 000 readings take five times as much
    evidence, _ = judged(model, ratios, touch, batch=500)
    assert [each.kind for each in evidence.suspicions] == (["swapped ends"] if line.lean else [])
