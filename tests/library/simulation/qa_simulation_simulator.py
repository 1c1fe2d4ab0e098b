# SPDX-License-Identifier: GPL-3.0-or-later
"""Simulated captures: files, truth, codes; and that a second simulator means the same levels."""

import errno
import json

import numpy as np
import pytest
import sigmf
import yaml
from command_runs import rows_of, succeeded
from gnuradio.wiforce.errors import InputError, OutputError
from gnuradio.wiforce.scene import load_scene, shipped_scenes
from gnuradio.wiforce.simulation import simulator
from rooms.rooms import Capture, Room
from second_simulator import channels

SHORT = {
    "phase_group": {"snapshots": 125},
    "sensors": [{"name": "arm", "model": "wiforce-900mhz"}],
    "reference_s": 0.01,
    "simulation": {
        "truth_model": "line-900mhz",
        "duration_s": 0.05,
        "presses": [
            {
                "start_s": 0.0125,
                "rise_s": 0.01,
                "hold_s": 0.01,
                "force_n": 4.0,
                "end_force_n": 6.0,
                "location_mm": 45.0,
            }
        ],
    },
}


def short(**simulation):
    return load_scene(SHORT | {"simulation": SHORT["simulation"] | simulation})


def codes_of(path):
    return np.fromfile(f"{path}.sigmf-data", "<i2")


@pytest.mark.parametrize("name", ["capture", "odd name.v1.2", "Kräfte und 力", "-dash"])
def test_simulate_any_name_gives_valid_sigmf(tmp_path, name):
    simulator.simulate(short(), tmp_path / name)
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        name + suffix for suffix in (".sigmf-data", ".sigmf-meta", ".truth.csv")
    )
    capture = sigmf.fromfile(str(tmp_path / (name + ".sigmf-meta")))
    capture.validate()
    info = capture.get_global_info()
    assert (info["core:datatype"], info["core:sample_rate"]) == ("ci16_le", 12.5e6)
    assert "core:dataset" not in info
    assert capture.get_captures()[0]["core:frequency"] == 900e6
    assert info["wiforce:seed"] == 1
    assert load_scene(info["wiforce:scene"]) == short()
    assert capture.sample_count == int(0.05 * 12.5e6 / 720) * 720  # whole frames


def test_truth_has_a_row_per_group_and_sensor(tmp_path):
    arm, leg = ({"name": name, "model": "wiforce-900mhz"} for name in ("arm", "leg, left"))
    press = SHORT["simulation"]["presses"][0] | {"sensor": "arm"}
    simulation = SHORT["simulation"] | {"presses": [press]}
    scene = load_scene(
        SHORT | {"sensors": [arm, leg | {"clock_hz": 1400}], "simulation": simulation}
    )
    simulator.simulate(scene, tmp_path / "x")
    rows = rows_of(tmp_path / "x.truth.csv")
    assert list(rows[0]) == [
        "time_s", "sensor", "touch", "force_n", "location_mm", "phase1_deg", "phase2_deg",
    ]  # fmt: skip
    groups = int(0.05 * 12.5e6) // (125 * 720)
    assert [row["sensor"] for row in rows] == ["arm", "leg, left"] * groups
    model = scene.load_model("line-900mhz")
    for i, row in enumerate(rows[::2]):
        time = (i + 0.5) * 125 * 720 / 12.5e6
        force = np.interp(time, [0.0125, 0.0225, 0.0325, 0.0425], [0, 4, 6, 0])
        assert row["location_mm"] == ("45.0" if 0.0125 <= time < 0.0425 else "")
        found = [float(row[name]) for name in ("time_s", "force_n", "phase1_deg", "phase2_deg")]
        assert found == pytest.approx([time, force, *model.phases_deg(force, 45.0)], abs=1e-4)
        assert row["touch"] == str(int(force >= model.onset_force_n))
    assert {row["touch"] for row in rows[::2]} == {"0", "1"}
    assert {row["touch"] for row in rows[1::2]} == {"0"}


def test_simulate_same_seed_gives_same_bytes(tmp_path):
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        simulator.simulate(short(seed=seed), tmp_path / name)
    for suffix in (".sigmf-data", ".sigmf-meta", ".truth.csv"):
        a, b, c = ((tmp_path / (name + suffix)).read_bytes() for name in "abc")
        assert a == b
        assert (a == c) == (suffix == ".truth.csv")


@pytest.mark.parametrize("bits", [8, 14])
def test_simulate_codes_are_left_justified_below_full_scale(tmp_path, bits):
    simulator.simulate(short(adc_bits=bits), tmp_path / "x")
    codes = codes_of(tmp_path / "x")
    assert not np.any(codes % 2 ** (16 - bits))
    assert np.any(codes % 2 ** (17 - bits))
    peak_db = 20 * np.log10(np.abs(codes.astype(float).view(complex)).max() / 32768)
    assert peak_db == pytest.approx(-3, abs=0.3)


def test_simulate_float_capture_equals_scaled_codes(tmp_path):
    simulator.simulate(short(), tmp_path / "int")
    simulator.simulate(short(), tmp_path / "float", datatype="cf32_le")
    floats = np.fromfile(tmp_path / "float.sigmf-data", "<f4")
    np.testing.assert_array_equal(floats * 32768, codes_of(tmp_path / "int"))
    simulator.simulate(short(adc_bits=None), tmp_path / "ideal", datatype="cf32_le")
    ideal = np.fromfile(tmp_path / "ideal.sigmf-data", "<f4")
    assert 0 < np.abs(ideal - floats).max() <= 0.51 / 8192


def test_simulate_two_antennas_are_replaced_together(tmp_path):
    environment = {"reader_clock": "free", "receive_antennas": 2}
    first, second = (
        load_scene(
            SHORT | {"environment": environment, "simulation": SHORT["simulation"] | {"seed": seed}}
        )
        for seed in (1, 2)
    )
    paths = simulator.simulate(first, tmp_path / "x")
    assert [path.name for path in paths[::3]] == ["x.sigmf-data", "x.antenna2.sigmf-data"]
    before = [path.read_bytes() for path in paths]
    assert before[0] != before[3] and len(before[0]) == len(before[3])
    free = 1.5 * len(before[0]) / 4

    def fill_the_disk(samples):
        nonlocal free
        free -= samples
        if free < 0:
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OutputError, match="No space left"):
        simulator.simulate(second, tmp_path / "x", progress=fill_the_disk, overwrite=True)
    assert [path.read_bytes() for path in paths] == before


def test_simulate_bad_folder_or_datatype_raises(tmp_path):
    with pytest.raises(InputError, match=r"none/x.*: cannot be written \(folder does not exist"):
        simulator.simulate(short(), tmp_path / "none" / "x")
    with pytest.raises(InputError, match="datatype: must be one of cf32_le, ci16_le, got 'ci8'"):
        simulator.simulate(short(), tmp_path / "x", datatype="ci8")


def test_command_simulate_writes_capture_and_truth(tmp_path):
    (tmp_path / "scene.yaml").write_text(yaml.safe_dump(SHORT))
    done = succeeded("simulate", "scene.yaml", "x", "--seed", 5, cwd=tmp_path)
    assert done.stderr == "gr-wiforce: 0.05 s, phase groups: 6, presses: 1, moves: 0, seed: 5\n"
    assert done.stdout.split() == ["x.sigmf-data", "x.truth.csv", "x.sigmf-meta"]
    assert json.loads((tmp_path / "x.sigmf-meta").read_text())["global"]["wiforce:seed"] == 5


def test_shipped_scenes_are_valid_and_described():
    from gnuradio.wiforce._config import DATA_DIR

    paths = sorted((DATA_DIR / "scenes").glob("*.yaml"))
    assert paths
    for path in paths:
        scene = load_scene(path)
        assert path.read_text(encoding="utf-8").startswith("# ")
        for sensor, tag in zip(scene.sensors, scene.simulation.tags, strict=True):
            assert tag.truth_model != sensor.model, f"{path.name} presses the reader's own model"


def levels_db(frames):
    """Static clutter and noise against the tag's line in H, from received frames."""
    h = channels(frames)
    window = np.kaiser(len(h), 14)[:, None]
    energy = len(h) * np.sum(window**2)
    spectrum = np.mean(np.abs(np.fft.fft(h * window, axis=0)) ** 2, axis=1) / energy
    hz = np.fft.fftfreq(len(h), 720 / 12.5e6)
    static, tag = (spectrum[np.abs(hz - line) < 30].sum() for line in (0, 1000))
    quiet = (np.abs(hz) > 300) & (np.abs(np.abs(hz) / 1000 % 1 - 0.5) < 0.2)
    noise = np.median(spectrum[quiet]) * len(h)
    return 10 * np.log10([static / tag, tag / noise])


def test_bench_simulator_has_same_levels(tmp_path):
    blocks = list(Capture(Room(duration_s=0.3), 1).blocks())
    second = levels_db(np.concatenate(blocks))
    scene = load_scene(
        {
            "sensors": [{"name": "arm", "model": "line-900mhz"}],
            "simulation": {"static_clutter_db": 50, "duration_s": 0.3, "adc_bits": 16},
        }
    )
    simulator.simulate(scene, tmp_path / "x")
    samples = codes_of(tmp_path / "x").astype(float).view(complex)
    first = levels_db(samples[: len(blocks) * 625 * 720])
    np.testing.assert_allclose(first, second, atol=0.3)
    # Aliased harmonics of the tag among the quiet bins raise their median a little.
    np.testing.assert_allclose(first, [50, 10], atol=0.5)


def test_captures_have_the_levels_of_their_link_budget(tmp_path):
    """Within 1 dB, at sample level: who compares with the paper relies on it."""
    content = load_scene("distance_1m").as_dict()
    content["simulation"] |= {"duration_s": 0.5, "presses": [], "tags": []}
    # With 20 dB less power, edges of the switches inside the average do not add to the noise.
    content["simulation"]["link"]["transmit_dbm"] = -10
    del content["simulation"]["snr_db"], content["simulation"]["static_clutter_db"]
    simulator.simulate(content, tmp_path / "x")
    samples = codes_of(tmp_path / "x").astype(float).view(complex)
    # Paths of 3 and 1 m lose 41.1 and 31.5 dB, switches and line 1 dB; 4 m lose 43.6 dB.
    assert levels_db(samples) == pytest.approx([43.0, 6.6], abs=1.0)


# What these press is not what their reader was calibrated with, or does not show force at all.
BEYOND_THEIR_MODEL = {"fingertip", "fingertip_on_points", "plain_trace"}


@pytest.mark.parametrize("name", sorted({*shipped_scenes()} - BEYOND_THEIR_MODEL))
def test_shipped_scenes_are_readable_with_their_model(name):
    """Where the phases are right, force and location are: the model was made of what is pressed."""
    scene = load_scene(name)
    sensors = {sensor.name: sensor for sensor in scene.sensors}
    truths = {tag.sensor: scene.load_model(tag.truth_model) for tag in scene.simulation.tags}
    for press in scene.simulation.presses:
        forces = np.linspace(press.force_n, press.end_force_n, 9)
        phases = truths[press.sensor].phases_deg(forces, press.location_mm)
        found = sensors[press.sensor].load_model(scene).invert(phases, std_deg=0.1)
        assert np.median(np.abs(found.force_n - forces)) < 0.12
        assert np.median(np.abs(found.location_mm - press.location_mm)) < 0.15
