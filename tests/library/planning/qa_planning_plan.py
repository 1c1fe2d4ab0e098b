# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a scene: what it chooses, what it expects, what it warns of, and the command."""

import dataclasses
import json

import numpy as np
import pytest
from command_runs import refused, run_command
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.planning.advice import improve, licence_note, outside_band, warnings
from gnuradio.wiforce.planning.expected import error_map, expect, phase_std_deg, receive_levels
from gnuradio.wiforce.planning.loss import end_variances, losses_db
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.planning.steps import steps
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.sensor import load_sensor, write_sensor
from gnuradio.wiforce.signal.weights import design_weights
from gnuradio.wiforce.simulation.simulator import simulate
from gnuradio.wiforce.simulation.truth import read_truth, score
from plain import averaged_switches, make_plan
from wiforce_app.read.recordings import read_capture

T, TA = 57.6e-6, 20.48e-6


def scene_of(sensor=None, **sections):
    """A scene of one sensor, of which keys may be stated."""
    arm = {"name": "arm", "model": "line-900mhz-calibrated"}
    return load_scene({"sensors": [arm | (sensor or {})], **sections})


@pytest.mark.parametrize("harmonics, clutter_hz", [(8, 0.0), (12, 0.0), (8, 60.0)])
def test_line_loss_equals_least_squares_over_tones(harmonics, clutter_hz):
    table = design_weights([1000.0], 625, T, clutter_hz, harmonics)
    clutter = table.basis[:, len(table.tones) :]
    ratios = []
    for phase in (0.1, 0.37, 0.72):
        for sign in (1, -1):
            hertz = 1000 * (1 + sign * 1e-4)
            times = table.times_s
            s = averaged_switches(hertz * times + phase, hertz * TA, points=400)
            basis = np.hstack([s, clutter])
            whole = np.diag(np.linalg.inv(basis.conj().T @ basis).real)[:2]
            mixing, noise = table.weights @ s, table.weights @ table.weights.conj().T
            information = mixing.conj().T @ np.linalg.solve(noise, mixing)
            ratios.append((np.diag(np.linalg.inv(information)).real, whole))
    taken, whole = np.mean(ratios, axis=0)
    loss = losses_db([harmonics], make_plan(clutter_hz=clutter_hz))[harmonics]
    # edges drawn to a 400th of a window
    assert loss == pytest.approx(10 * np.log10(taken / whole), abs=0.01)


def test_plan_chooses_fewest_harmonics_within_a_tenth_of_a_db():
    chosen = plan(scene_of())
    losses = {h: losses_db([h], chosen)[h].max() for h in (8, 12, 16, 24)}
    accepted = [h for h, loss in losses.items() if loss <= min(losses.values()) + 0.1]
    assert chosen.harmonics == min(accepted) and losses[8] > losses[chosen.harmonics]
    assert max(chosen.loss_db) == pytest.approx(losses[chosen.harmonics])


@pytest.mark.parametrize(
    "clock_hz, snapshots, band_hz",
    [(1000.0, 625, 250.0), (1000.0, 250, 30.0), (1000.0, 125, 0.0), (400.0, 625, 0.0)],
)
def test_automatic_clutter_band_costs_a_tenth_of_a_db_at_most(clock_hz, snapshots, band_hz):
    """Readings in a quiet room must not pay for movers that may never come."""
    chosen = plan(scene_of({"clock_hz": clock_hz}, phase_group={"snapshots": snapshots}))
    assert chosen.clutter_hz == band_hz
    still, moving = (
        end_variances(dataclasses.replace(chosen, clutter_hz=hertz)) for hertz in (0.0, band_hz)
    )
    assert moving.max() <= still.max() * 10**0.01


@pytest.mark.parametrize("snapshots", [33, 97, 110, 136, 500])
def test_plan_short_group_falls_back_to_fewer_lines(snapshots):
    clocks = [("a", 1000), ("b", 1400)] if snapshots < 500 else [("a", 700), ("b", 1000)]
    sensors = [
        {"name": n, "model": "line-900mhz-calibrated", "clock_hz": f, "clock_tolerance_ppm": 10}
        for n, f in (clocks[:1] if snapshots < 90 else clocks)
    ]
    chosen = plan({"sensors": sensors, "phase_group": {"snapshots": snapshots}})
    assert np.all(np.isfinite(chosen.table.weights))


def test_steps_not_needed_are_skipped_with_reason():
    still = {s.name: s for s in steps(plan(scene_of(environment={"moving_clutter_hz": 0})))}
    assert "nothing moves" in still["tones"].reason
    skipped = [name for name, step in still.items() if not step.needed]
    assert "channel per snapshot" in skipped and len(skipped) == 3


def test_steps_operations_equal_hand_count():
    scene = scene_of()
    found = {s.name: s.operations for s in steps(plan(scene))}
    rate = 12.5e6 / 720
    assert found["fold"] == pytest.approx(3 * 64 * 2 * rate)
    assert found["guard and first repetition"] == pytest.approx((400 + 64) * 2 * rate)
    # a pair of tones: 4 products and 4 sums for each of 64 samples of a snapshot, twice over
    pairs = len(plan(scene).table.tones) / 2
    assert found["tones"] == pytest.approx(8 * 64 * pairs * rate)


PRESS = {"start_s": 0.35, "rise_s": 0.05, "hold_s": 0.5, "force_n": 3.0, "location_mm": 52.0}
MOVING = {
    "phase_group": {"snapshots": 250},
    "environment": {"moving_clutter_hz": 40},
    "reference_s": 0.3,
    "simulation": {
        "truth_model": "line-900mhz",
        "duration_s": 1.0,
        "seed": 4,
        "snr_db": 0,
        "static_clutter_db": 40,
        "moving_clutter_db": 20,
        "presses": [PRESS],
    },
}


def test_expect_simulated_scene_gives_errors_of_readings(tmp_path):
    scene = scene_of(**MOVING)
    expected = expect(plan(scene))[0]
    simulate(scene, tmp_path / "capture")
    readings = read_capture(open_capture(tmp_path / "capture"), scene)
    found = score(readings, read_truth(tmp_path / "capture.truth.csv"), "arm")
    assert len(found.force_error_n) >= 20
    # of the change against the untouched sensor: what the calibration errs by there is constant
    truth = scene.load_model(scene.simulation.tags[0].truth_model).untouched_deg()
    bias = np.subtract(scene.load_model(scene.sensors[0].model).untouched_deg(), truth)
    phase = np.median(np.abs(found.phase_error_deg - bias))
    assert 1 / 1.5 < phase / np.mean(expected.phase_error_deg) < 1.5
    assert 0.5 < found.median_force_n / expected.force_error_n < 2


def test_receive_levels_adc_steps_equal_simulator():
    from gnuradio.wiforce.simulation.channel import AirChannel

    scene = scene_of()
    levels = receive_levels(scene)
    noise_steps = AirChannel(scene).noise_std / np.sqrt(2) * 2**13
    # the simulator's static echoes add up to another peak, by up to 3 dB
    assert 0.7 < levels.noise_steps / noise_steps < 1.41


FAST = PRESS | {"start_s": 0.8, "rise_s": 0.02}


@pytest.mark.parametrize(
    "scene, warning",
    [
        ({"sounding": {"repetitions": 2}}, "only one repetition is averaged"),
        ({"simulation": {"presses": [FAST]}}, "N_g against dynamics"),
        ({"simulation": {"presses": [FAST | {"location_mm": 75.0}]}}, "calibrated for"),
        ({"simulation": {"moves": [{"start_s": 1, "distance_mm": 9}]}}, "tags that stand still"),
        ({"simulation": {"static_clutter_db": 110, "snr_db": 20}}, "out of the ADC's range"),
        ({"simulation": {"tags": [{"clock2_duty": "two_frequencies"}]}}, "on at the same time"),
        ({"environment": {"reader_clock": "free"}}, "one receive antenna"),
        ({"simulation": {"moving_clutter_db": 10, "moving_clutter_hz": 300}}, "leaks"),
    ],
)
def test_warnings_faulty_scene_names_fault(scene, warning):
    scene = scene_of(**scene)
    assert any(warning in found for found in warnings(plan(scene)))


@pytest.mark.parametrize(
    "model, another", [("line-900mhz-calibrated", False), ("wiforce-900mhz", True)]
)
def test_pressing_another_sensor_than_the_one_that_is_read_is_stated(model, another):
    """Who puts a sensor of their own into a scene would take errors of newtons for its own."""
    pressed = {"truth_model": "line-900mhz"}
    texts = warnings(plan(scene_of({"model": model, "clock_hz": 1035}, simulation=pressed)))
    assert any("simulation.truth_model line-900mhz" in text for text in texts) == another


def test_improve_proposals_have_stated_effect():
    scene = scene_of(simulation={"presses": [FAST]})
    found = improve(plan(scene))
    guard = next(p for p in found if p.change.startswith("sounding.frame_length: 320"))
    # 2.25 x the snapshots, each as good
    assert guard.phase_std_deg[0] / guard.phase_std_deg[1] == pytest.approx(1.5, rel=0.05)
    shorter = next(p for p in found if p.change.startswith("phase_group.snapshots"))
    assert shorter.time_resolution_s[1] <= 0.02 / 2 * 1.01


def test_command_states_errors_first_and_steps_on_request():
    """A newcomer who asks how well his scene is read got 20 lines of steps first."""
    done = run_command("plan", "two_sensors", "--steps")
    assert done.stdout.startswith("expected median errors") and "separation " in done.stdout
    assert "separation " not in run_command("plan", "two_sensors").stdout


def test_command_draws_errors_over_force_and_location(tmp_path):
    picture = tmp_path / "errors.png"
    done = run_command("plan", "demo", "--plot", picture)
    assert done.returncode == 0 and picture.read_bytes().startswith(b"\x89PNG")
    refused("plan", "demo", "--plot", tmp_path / "errors.txt")
    spread = error_map(plan("demo"), 0, np.array([2.0, 5.0]), np.array([20.0, 40.0, 60.0]))
    assert spread.shape == (2, 3, 2)
    # The contact saturates: the same error of phase is more force where less of it moves.
    assert (spread[1, :, 0] > spread[0, :, 0]).all() and (spread > 0).all()


def test_command_json_holds_results_of_functions(tmp_path):
    text = "sensors: [{name: arm, model: line-900mhz, clock_hz: 1035}]\n"
    (tmp_path / "scene.yaml").write_text(text + "environment: {band: us-902-928}\n")
    done = run_command("plan", tmp_path / "scene.yaml", "--json", "--improve")
    report, settings = json.loads(done.stdout), plan(tmp_path / "scene.yaml")
    assert report["expected"][0]["force_error_n"] == expect(settings)[0].force_error_n
    assert report["settings"]["harmonics"] == settings.harmonics
    assert report["proposals"] and report["notes"] == []
    assert report["warnings"] == warnings(settings) and "us-902-928" in report["warnings"][0]


def on_air(carrier_hz, rate_hz=12.5e6, band=None):
    """A scene on a carrier, whatever its model holds."""
    scene = scene_of(radio={"sample_rate_hz": rate_hz}, environment={"band": band})
    radio = dataclasses.replace(scene.radio, center_frequency_hz=carrier_hz)
    return dataclasses.replace(scene, radio=radio)


# Edges from 47 CFR 15.247 and ERC 70-03.
@pytest.mark.parametrize(
    "carrier_hz, rate_hz, band, warned",
    [
        (915e6, 12.5e6, "us-902-928", False),
        (908e6, 12.5e6, "us-902-928", True),  # 901.95 MHz
        (908.1e6, 12.5e6, "us-902-928", False),  # 902.05 MHz
        (866.5e6, 6.25e6, "eu-863-870", False),
        (2440e6, 12.5e6, "eu-2400-2483.5", False),
        (900e6, 12.5e6, None, False),
    ],
)
def test_plan_warns_outside_stated_band(carrier_hz, rate_hz, band, warned):
    """Transmitting outside the band is an offence that the file's writer wanted to avoid."""
    found = list(outside_band(on_air(carrier_hz, rate_hz, band)))
    assert bool(found) == warned
    assert all(f"environment.band {band} " in text for text in found)


def test_licence_note_names_no_band_only_without_stated_band():
    """One remark, and none where the user has decided or the band is free."""
    assert not list(licence_note(on_air(915e6)))
    (note,) = licence_note(on_air(900e6))
    assert "893.945 to 906.055 MHz" in note
    assert not list(licence_note(on_air(900e6, band="us-902-928")))


TWO_ANTENNAS = {"reader_clock": "free", "receive_antennas": 2}


@pytest.mark.parametrize(
    "snr_db, off_std, environment, limit",
    [
        (-15, 0, {}, "radio"),
        (20, 0, {}, "calibration"),
        (10, 0.005, {}, "off states"),  # a pair known to 0.01 was said to read 4 N to 0.05 N
        (20, 0, TWO_ANTENNAS, "two antennas"),
    ],
)
def test_what_limits_the_errors_is_counted_and_named(snr_db, off_std, environment, limit):
    """More transmit power does not help where the calibration is the limit."""
    off = {"off_reflection": [[0.3, 0.0], [-0.3, 0.0]], "off_reflection_std": off_std}
    scene = scene_of(off, simulation={"snr_db": snr_db}, environment=environment)
    settings, exact = plan(scene), plan(scene_of(off | {"off_reflection_std": 0}))
    (found,), (best,) = expect(settings), expect(exact)
    assert found.limited_by == limit and ", limited by the " in str(found)
    assert limit == "calibration" or found.force_error_n > 1.5 * best.force_error_n
    wrong_n, right_n = (
        error_map(p, 0, np.r_[4.0], np.r_[40.0])[0, 0, 0] for p in (settings, exact)
    )
    assert limit != "off states" or wrong_n > 1.5 * right_n


def test_error_of_the_ruler_is_part_of_every_expected_location(tmp_path):
    """The picture of `plan --plot` promised locations that readings do not reach."""
    model = load_sensor("line-900mhz-calibrated")
    write_sensor(dataclasses.replace(model, ruler_std_mm=0.0), tmp_path / "exact.yaml")
    write_sensor(dataclasses.replace(model, ruler_std_mm=0.5), tmp_path / "ruled.yaml")
    maps, found = [], []
    for name in ("exact", "ruled"):
        settings = plan(scene_of({"model": str(tmp_path / f"{name}.yaml")}))
        maps.append(error_map(settings, 0, np.r_[2.0, 4.0], np.r_[30.0, 50.0]))
        found += [each.location_error_mm for each in expect(settings)]
    assert maps[1][..., 0] == pytest.approx(maps[0][..., 0])
    assert maps[1][..., 1] == pytest.approx(np.hypot(maps[0][..., 1], 0.5))
    assert found[0] < 0.67 * 0.5 < found[1]


def test_share_of_the_span_that_is_flagged_is_stated():
    """Of two locations that the paper measured, half of the span between them says nothing."""
    (partly,) = expect(plan(scene_of({"model": "wiforce-900mhz", "clock_hz": 1035})))
    assert f"span without the {partly.flagged:.0%} where readings are flagged, " in str(partly)
    assert 0.4 < partly.flagged < 0.6


@pytest.mark.parametrize(
    "clock_hz, frame_length, snapshots, clutter_hz, message",
    [
        (1000, 720, 40, 200, "phase_group.snapshots: "),
        (1000, 720, 625, 985, "environment.moving_clutter_hz: must lie more than"),
        (390, 4000, 125, "auto", r"sensors\[0\].clock_hz: must leave the tag a line"),
    ],
)
def test_plan_infeasible_weights_names_key_of_scene(
    clock_hz, frame_length, snapshots, clutter_hz, message
):
    """Users edit the scene's file: a parameter of an inner function would tell them nothing."""
    scene = scene_of(
        {"clock_hz": clock_hz},
        sounding={"frame_length": frame_length},
        phase_group={"snapshots": snapshots},
        environment={"moving_clutter_hz": clutter_hz},
    )
    with pytest.raises(InputError, match=message):
        plan(scene)


def test_noise_of_two_synthesizers_beside_a_static_path_is_expected():
    """By hand: -101 dBc/Hz at 60 dB, aliased from a loop of 30 kHz, q = 0.155, 36 ms."""
    loud = {"snr_db": 60, "static_clutter_db": 60, "adc_bits": None}
    settings = plan(scene_of(simulation=loud | {"radio_noise": {}}))
    hertz = 1000 + np.arange(-30, 31) * 12.5e6 / 720
    density = 10**-10.1 * np.sum(np.sinc(hertz * 20.48e-6) ** 2 / (1 + (hertz / 30e3) ** 2))
    line = 0.25 * np.sinc(0.25) * np.sinc(0.02048)
    variance = line**2 * 1e6 * density / (2 * 0.155 * 0.036) * (1 + 1 / 13)
    assert phase_std_deg(settings).mean() == pytest.approx(np.degrees(np.sqrt(variance)), rel=0.03)
    assert any("dynamic range" in text for text in warnings(settings))


@pytest.mark.parametrize(
    "change",
    [
        {"radio_noise": None},
        {"radio_noise": {"synthesizers": "one", "transmitter_dbc_hz": -200}},
        {"radio_noise": {}, "static_clutter_db": None},
    ],
)
def test_radios_that_add_no_noise_cost_nothing(change):
    settings = plan(scene_of(simulation=change))
    assert receive_levels(settings.scene).radio < 1e-6 * receive_levels(settings.scene).noise
    assert not any("dynamic range" in text for text in warnings(settings))


def test_two_antennas_share_phase_noise_but_not_the_transmitters():
    scenes = [scene_of(environment=e, simulation={"radio_noise": {}}) for e in ({}, TWO_ANTENNAS)]
    one, two = (receive_levels(scene).radio for scene in scenes)
    line = 0.25 * np.sinc(0.25) * np.sinc(0.02048)
    sent = line**2 * 1e6 * 10**-14.5 * 12.5e6 * 62 / 256
    assert two == pytest.approx(sent, rel=1e-6) and one > 100 * two
