# SPDX-License-Identifier: GPL-3.0-or-later
"""Sensor models at another carrier than that of their calibration."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from command_runs import succeeded
from gnuradio.wiforce.calibration.calibrate import calibrate
from gnuradio.wiforce.calibration.tables import read_vna_csv
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.planning.advice import warnings
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.sensor import load_sensor
from gnuradio.wiforce.sensor.line import transfer_std_deg
from gnuradio.wiforce.signal.carrier import wrap_deg
from long_cases import cases
from sensor_laws import LAWS, LENGTH_MM, untouched_deg, vna_rows

FORCES_N = np.linspace(0.9, 8.0, 24)
LIGHT_MM_S = 299_792_458_000.0


@dataclass(frozen=True)
class Connected:
    """A sensor behind connectors: a lossless mismatch with a length of cable on either side.

    Its ports have different ones, so nothing of them cancels between the ends.
    """

    law: object
    reflection: float
    cables_mm: tuple

    def _seen_deg(self, phases_deg, frequency_hz):
        """Phases of the line's reflections as the reader sees them; shape (..., 2)."""
        seen = []
        for port, (outer_mm, inner_mm) in enumerate(self.cables_mm):
            round_trip = np.exp(
                -4j * np.pi * frequency_hz / LIGHT_MM_S * np.array([outer_mm, inner_mm])
            )
            load = np.exp(1j * np.radians(phases_deg[..., port])) * round_trip[1]
            rho = self.reflection  # s11 = rho, s22 = -rho, s21^2 = 1 - rho^2
            seen.append(np.degrees(np.angle(round_trip[0] * (rho + load) / (1 + rho * load))))
        return np.stack(seen, axis=-1)

    def phases_deg(self, force_n, location_mm, frequency_hz):
        return self._seen_deg(self.law.phases_deg(force_n, location_mm, frequency_hz), frequency_hz)

    def untouched_deg(self, frequency_hz):
        return self._seen_deg(np.full(2, untouched_deg(frequency_hz)), frequency_hz)


def calibrated(sensor, carrier_hz, folder, rng):
    """A calibration of five locations at one carrier, with a VNA's noise of 0.2 deg."""
    rows = vna_rows(sensor, carrier_hz, FORCES_N, 0.2, rng)
    untouched = sensor.untouched_deg(carrier_hz) + 0.05 * rng.standard_normal(2)
    for port in (1, 2):
        rows[port] = f"{carrier_hz / 1e6:.3f},,{port},0,{untouched[port - 1]:.4f}"
    path = folder / "vna.csv"
    path.write_text("\n".join(rows) + "\n")
    return calibrate(read_vna_csv(path, carrier_hz), "arm")


@pytest.mark.parametrize("from_hz, to_hz", cases((900e6, 915e6), long=((2400e6, 2440e6),)))
def test_transferred_model_holds_truth_within_two_sigma(from_hz, to_hz, tmp_path):
    """Without the added uncertainty, connectors make readings at the new carrier falsely exact."""
    rng = np.random.default_rng(915)
    inside, alone, ratio = [], [], []
    for seed in range(2):
        cables = rng.uniform(5, 20, (2, 2))
        sensor = Connected(LAWS[seed % 3], 0.07, tuple(map(tuple, cables)))
        bench = calibrated(sensor, from_hz, tmp_path, rng)
        moved = bench.at_carrier(to_hz)
        force, location = rng.uniform(1.5, 7.5, 40), rng.uniform(22, 58, 40)
        # As the receiver: the change against the untouched sensor, from the model's own phases.
        change = sensor.phases_deg(force, location, to_hz) - sensor.untouched_deg(to_hz)
        seen = moved.untouched_deg() + change + 0.1 * rng.standard_normal((40, 2))
        for model, found in ((moved, inside), (replace(moved, transfer_std_deg=0.0), alone)):
            read = model.invert(seen, 0.1)
            clear = np.array(["ambiguous" not in flags for flags in read.flags])
            force_error = np.abs(read.force_n - force) / read.force_std_n
            place_error = np.abs(read.location_mm - location) / read.location_std_mm
            found.append((force_error < 2)[clear])
            found.append((place_error < 2)[clear])
            if model is moved:
                ratio.append(np.mean(force_error[clear] ** 2))
    assert np.mean(np.concatenate(inside)) >= 0.9
    assert np.mean(np.concatenate(alone)) < np.mean(np.concatenate(inside)) - 0.05
    # Nor may it be inflated: stated at most three times what it is.
    assert np.sqrt(np.mean(ratio)) > 1 / 3


@pytest.mark.parametrize("to_hz", [868e6, 980e6])
def test_transferred_model_is_that_of_line_at_other_carrier(to_hz):
    """Contact positions carry over in millimetres; anything else would be a systematic error."""
    bench, line = load_sensor("line-900mhz-calibrated"), load_sensor("line-900mhz")
    moved, air, ratio = bench.at_carrier(to_hz), line.at_carrier(to_hz), to_hz / 900e6
    presses = np.meshgrid([1.5, 3.0, 6.0], [22.0, 35.0, 48.0])
    own = wrap_deg(bench.phases_deg(*presses) - line.phases_deg(*presses))
    # The calibration's own errors scale too, and nothing is added to them.
    error = wrap_deg(moved.phases_deg(*presses) - air.phases_deg(*presses))
    assert error == pytest.approx(ratio * own, abs=1e-6)
    untouched = np.subtract(bench.untouched_deg(), line.untouched_deg())
    assert np.subtract(moved.untouched_deg(), air.untouched_deg()) == pytest.approx(
        ratio * untouched
    )


def test_transfer_neither_scales_turns_nor_adds_there_and_back():
    """Phases count modulo 360 deg: a calibration that is a turn higher is the same one."""
    bench = load_sensor("line-900mhz-calibrated")
    (carrier,) = bench.carriers
    turned = replace(carrier, coefficients_deg=carrier.coefficients_deg - 720.0)
    found = replace(bench, carriers=(turned,)).at_carrier(915e6).phases_deg(4.0, 33.0)
    assert found == pytest.approx(bench.at_carrier(915e6).phases_deg(4.0, 33.0))
    back = bench.transferred(915e6).transferred(930e6).transferred(900e6)
    assert back.transfer_std_deg == pytest.approx(0, abs=1e-9)
    assert back.phases_deg(4.0, 33.0) == pytest.approx(bench.phases_deg(4.0, 33.0))


def test_transfer_std_grows_with_distance_and_is_that_of_random_connectors():
    """The stated uncertainty follows from a stated connector, at every distance."""
    rng, rho, way_mm = np.random.default_rng(3), 0.07, LENGTH_MM + 30.0
    previous = 0.0
    for to_hz in (905e6, 915e6, 940e6, 980e6):
        turn = 4 * np.pi * (to_hz - 900e6) * way_mm / LIGHT_MM_S
        phase = 2 * np.pi * rng.random((2, 200_000))
        ripple = 2 * rho * (np.sin(phase + turn) - np.sin(phase))
        expected = np.degrees(np.std(ripple[0] - ripple[1]))
        found = transfer_std_deg(LENGTH_MM, 1.0, 900e6, to_hz)
        assert found == pytest.approx(expected, rel=0.01) and found > previous
        previous = found
    assert transfer_std_deg(LENGTH_MM, 1.0, 900e6, 900e6) == 0


def test_transfer_beyond_a_tenth_is_refused():
    """At twice the carrier, a calibration says nothing about connectors."""
    for name in ("wiforce-900mhz", "line-900mhz"):
        with pytest.raises(InputError, match=f"{name}: carrier must be within 10 % of 900 MHz"):
            load_sensor(name, frequency_hz=2.4e9)


def test_scene_transfers_its_models_and_plan_says_so():
    """A scene at 915 MHz works with a sensor of 900 MHz, and its user learns what that costs."""
    sensor = {"name": "arm", "model": "wiforce-900mhz", "clock_hz": 1035}
    scene = {"radio": {"center_frequency_hz": 915e6}, "sensors": [sensor]}
    found = warnings(plan(load_scene(scene)))
    assert len(found) == 1 and "calibrated at 900 MHz: transferred to 915 MHz" in found[0]
    model = plan(scene).sensors[0].model
    assert model.model_std_deg(4.0, 33.0) == pytest.approx(
        np.hypot(915 / 900 * load_sensor("wiforce-900mhz").model_std_deg(4.0, 33.0), 0.55), rel=0.01
    )


def test_command_transfer_writes_sensor_that_scenes_load(tmp_path):
    """Users without a VNA at their carrier start from this file."""
    path = tmp_path / "arm.yaml"
    done = succeeded("transfer", "wiforce-2400mhz", "--frequency-hz", "2440e6", "-o", path)
    assert "calibrated at 2400 MHz, 1.5 deg added" in done.stdout
    made, shipped = load_sensor(path), load_sensor("wiforce-2440mhz")
    assert made.name == "arm" and made.transferred_from_hz == 2400e6
    assert made.phases_deg(FORCES_N, 33.0) == pytest.approx(shipped.phases_deg(FORCES_N, 33.0))
    assert made.model_std_deg(4.0, 33.0) == pytest.approx(shipped.model_std_deg(4.0, 33.0))
    assert "2440 MHz are those at 2400 MHz" in made.provenance["assumed"][-1]
