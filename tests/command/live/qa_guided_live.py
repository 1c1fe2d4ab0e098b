# SPDX-License-Identifier: GPL-3.0-or-later
"""A guided calibration at the software N210, by a scripted person, against one with a VNA."""

import json

import numpy as np
import pytest
import yaml
from command_runs import refused
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import measure_vna
from gnuradio.wiforce.sensor import load_sensor
from guided_operator import GuidedOperator
from live_runs import FRAMES, GAINS, SLOW, scene_of
from software_usrp import SoftwareUsrp

SPEED = 4
# Nothing of the sensor on the air is known to the reader: neither its contact nor its ports.
TRUE_SENSOR = {
    "name": "true",
    "kind": "line",
    "length_mm": 80.0,
    "onset_force_n": 0.7,
    "force_span_n": [0.7, 10.0],
    "location_span_mm": [5.0, 75.0],
    "permittivity": 1.0,
    "provenance": {"source": "test", "date": "2026-01-31"},
    "frequencies_hz": [900.0e6],
    "port_offset_deg": [35.0, -60.0],
    "contact": {"decay_length_mm": 4.6, "asymmetry": 0.55, "fade_mm": 8.0},
}
LOCATIONS, FORCES = (40.0, 60.0), (1.0, 2.0, 4.0, 6.0, 8.0)


class Bench:
    """A device with the true sensor, and the command that calibrates it."""

    def __init__(self, folder):
        (folder / "true.yaml").write_text(yaml.safe_dump(TRUE_SENSOR))
        scene = scene_of([], 400, 0.3, **SLOW)
        # With this model the reader takes presses in the middle for motions of the tag.
        scene["sensors"][0]["model"] = "wiforce-900mhz"
        scene["simulation"] |= {"truth_model": "true.yaml", "duration_s": 1000}
        (folder / "scene.yaml").write_text(json.dumps(scene))
        self.true = load_sensor(folder / "true.yaml")
        self._scene = folder / "scene.yaml"
        self.device = SoftwareUsrp(self._scene, speed=SPEED)

    def person(self, output, **options):
        words = ["--scene", self._scene, "--args", f"{self.device.args},{FRAMES}", *GAINS]
        words += ["--locations", ",".join(map(str, LOCATIONS))]
        words += ["--forces", ",".join(map(str, FORCES)), "-o", output]
        return GuidedOperator(self.device, ["calibrate", "--live", *words], **options)


def errors(true, model, noise_deg=0.15, count=400):
    """Absolute errors of force and location, and how often they lie within two std."""
    rng = np.random.default_rng(7)
    force = rng.uniform(FORCES[0] + 0.5, FORCES[-1] - 0.5, count)
    place = rng.uniform(*LOCATIONS, count)
    phases = true.phases_deg(force, place) - true.untouched_deg()
    phases += model.untouched_deg() + noise_deg * rng.standard_normal((count, 2))
    found = model.invert(phases, noise_deg)
    force_error = np.abs(found.force_n - force)
    place_error = np.abs(found.location_mm - place)
    within = np.mean(force_error < 2 * found.force_std_n)
    return force_error, place_error, within, np.mean(place_error < 2 * found.location_std_mm)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    made = Bench(tmp_path_factory.mktemp("bench"))
    yield made
    if made.device.process.poll() is None:
        made.device.stop()


def test_guided_sensor_reads_as_one_calibrated_with_a_vna(bench, tmp_path):
    """The person's sensor would be worse than the sensor's own noise."""
    sensor = tmp_path / "arm.yaml"
    with bench.person(sensor, seed=2) as person:
        person.follow()
    vna = calibrate(measure_vna(bench.true, LOCATIONS, FORCES, 0.2), "vna")
    force, place, force_within, place_within = errors(bench.true, load_sensor(sensor))
    vna_force, vna_place, *_ = errors(bench.true, vna)
    assert np.median(force) < np.median(vna_force) + 0.1
    # A quarter of a millimetre is the error of the ruler.
    assert np.median(place) < np.median(vna_place) + 0.4
    assert force_within > 0.85 and place_within > 0.85


@pytest.mark.parametrize(
    ("words", "rule"),
    [
        (["arm.yaml", "--scene", "demo", "--args", "addr=127.0.0.9"], "must end in .csv"),
        (["--scene", "demo", "--args", "addr=127.0.0.9", "--sensor", "leg"], "scene's: arm, got"),
        (["--scene", "demo", "--args", "addr=127.0.0.9", "--length-mm", "60"], "must be that of"),
        (["--scene", "demo"], "--args: must be given with --live"),
        (["--scene", "demo", "--args", "a", "--kind", "vna"], "must be given without"),
        (["t.csv", "--sweeps", "2"], "--sweeps needs --live"),
    ],
)
def test_guided_calibration_that_cannot_begin_leaves_no_file(tmp_path, words, rule):
    guided = ["--live"] * ("--scene" in words)  # without it, options would be ignored
    assert rule in refused("calibrate", *guided, *words, "-o", tmp_path / "arm.yaml")
    assert list(tmp_path.iterdir()) == []


def test_same_command_continues_with_a_new_reference(bench, tmp_path):
    """It is all that helps where the tag has moved: presses that are stored were lost."""
    for stored in (1, 2):
        with bench.person(tmp_path / "arm.yaml") as person:
            for _ in range(2):
                person.answer(person.prompt())
            assert person.prompt() is not None
            assert "  untouched: phases -172.9" in person.shown
            assert f"stored, {stored} of 10" in person.shown
            person.release()
            person.type("q")
            assert person.prompt() is None
    assert "arm.taps.csv: 1; the session continues." in person.shown
    assert "presses stored in" in person.shown and "the same command continues." in person.shown
