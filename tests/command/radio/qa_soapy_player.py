# SPDX-License-Identifier: GPL-3.0-or-later
"""Radios that lack what a USRP has: times, full duplex, reports of losses (soapy_player.cc)."""

import json

import numpy as np
import pytest
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.scene import load_scene
from gnuradio.wiforce.simulation.simulator import simulate
from live_runs import SLOW, SLOW_GROUP_S, rows_of, run_session, scene_of
from wiforce_app.radio import soapy

RATE, FRAME = SLOW["radio"]["sample_rate_hz"], SLOW["sounding"]["frame_length"]
pytestmark = pytest.mark.usefixtures("soapy_player")
FORCE_N, LOCATION_MM = 4.0, 45.0
PRESS_S = 0.6, 1.6  # with the rise and the fall
DURATION_S = 2.1
LOSS = round(0.85 * RATE)  # in the press

# What is lost, and what the run says of it.
LOSSES = {
    "nothing": ("time=0", 0, ""),
    "odd": (f"time=0,drops={LOSS}:1234", 1234, "frame timing shifted once"),
    "whole frames": (f"time=0,drops={LOSS}:{7 * FRAME}", 7 * FRAME, ""),
    "reported": (f"time=0,overflow={LOSS}:1234", 1234, "frame timing shifted once"),
    "stale": (f"stale=1,overflow={LOSS}:1234", 1234, "frame timing shifted once"),
    "timed": (f"overflow={LOSS}:1234", 1234, "1 gap, 1234 samples lost"),
}


@pytest.fixture(scope="module")
def played(tmp_path_factory):
    """Scene and samples of a press at 2.5 Msps, which begin in the middle of a frame."""
    folder = tmp_path_factory.mktemp("played")
    press = scene_of([(PRESS_S[0], FORCE_N, FORCE_N, LOCATION_MM)], 400, 0.3, **SLOW)
    press["simulation"] |= {"duration_s": DURATION_S + 0.3, "seed": 8}
    scene = folder / "scene.yaml"
    scene.write_text(json.dumps(press))
    simulate(load_scene(scene), folder / "press")
    codes = np.fromfile(folder / "press.sigmf-data", "<i2")
    codes[2 * 137 :].tofile(folder / "played.ci16")
    return scene, folder / "played.ci16"


def start(scene, file, arguments, *options):
    """Options of a live run with the player."""
    args = f"driver=player,file={file},{arguments}"
    return ["--scene", str(scene), "--driver", "soapy", "--args", args, *map(str, options)]


def wrong(row, lost_s):
    """What an unflagged reading says that cannot be, None when all is well."""
    if row["flags"]:
        return None
    margin = SLOW_GROUP_S / 2 + lost_s
    begin, end = float(row["time_s"]) - margin, float(row["time_s"]) + margin
    if row["touch"] == "0":
        return "touch is missed" if begin > PRESS_S[0] + 0.1 and end < PRESS_S[1] - 0.1 else None
    if end < PRESS_S[0] or begin > PRESS_S[1]:
        return "touch is invented"
    for name, true, least in (("force", FORCE_N, 0.25), ("location", LOCATION_MM, 1.0)):
        unit = "n" if name == "force" else "mm"
        found, std = float(row[f"{name}_{unit}"]), float(row[f"{name}_std_{unit}"])
        rises = name == "force" and (begin < PRESS_S[0] + 0.1 or end > PRESS_S[1] - 0.1)
        if abs(found - true) > max(least, 5 * std) and not rises:
            return f"{name} {found} +- {std}"
    return None


def test_soapy_lost_samples_never_give_a_wrong_unflagged_reading(played, tmp_path, long_run):
    """Without times, frames and the tag's clock show what was lost."""
    cases = {
        name: start(*played, arguments, "-o", tmp_path / f"{name}.csv", "--duration", 2)
        for name, (arguments, *_) in LOSSES.items()
        if long_run or name == "timed"
    }
    statuses, said = run_session("refused", *map(json.dumps, cases.values()))
    assert statuses == [0] * len(cases), said
    reports = [line for line in said.splitlines() if line.startswith("gr-wiforce: read ")]
    for name, report in zip(cases, reports, strict=True):
        _, lost, words = LOSSES[name]
        assert words in report, (name, report)
        rows = rows_of(tmp_path / f"{name}.csv")
        found = [(row["time_s"], wrong(row, lost / RATE)) for row in rows]
        assert not [each for each in found if each[1]], name
        assert all(row["time_utc"] for row in rows)
        clear = [row for row in rows if not row["flags"]]
        touched = [float(row["time_s"]) for row in clear if row["touch"] == "1"]
        loss_s = LOSS / RATE
        assert min(touched) < loss_s - 0.1 and max(touched) > PRESS_S[1] - 0.15, name
        assert clear[-1]["touch"] == "0"
        near = [row for row in rows if abs(float(row["time_s"]) - loss_s) < SLOW_GROUP_S]
        assert lost == 0 or any(row["flags"] for row in near), name


@pytest.mark.timeout(1200)
def test_soapy_random_losses_without_times_never_give_a_wrong_unflagged_reading(
    played, tmp_path, long_run
):
    """Nobody reports what is lost, and it may be any number of samples at any time."""
    rng = np.random.default_rng(12)
    symbol = 64
    flagged = clear = 0
    for batch in range(20 if long_run else 1):
        runs, lost = [], []
        for n in range(3 if long_run else 1):
            at = np.sort(rng.uniform(0.35, 1.9, rng.integers(1, 4)) * RATE).astype(int)
            any_number = rng.integers(1, 20_000, len(at))
            special = rng.choice([1, FRAME, 2 * symbol, 9 * FRAME + 1, FRAME - 1], len(at))
            count = np.where(rng.random(len(at)) < 0.5, any_number, special)
            drops = ";".join(f"{a}:{c}" for a, c in zip(at, count, strict=True))
            output = tmp_path / f"{batch}-{n}.csv"
            arguments = f"time=0,drops={drops}"
            runs.append(start(*played, arguments, "-o", output, "--duration", 1.9))
            lost.append((output, drops, count.sum() / RATE))
        statuses, said = run_session("refused", *map(json.dumps, runs))
        assert statuses == [0] * len(runs), said
        for output, drops, lost_s in lost:
            rows = rows_of(output)
            found = [(row["time_s"], wrong(row, lost_s)) for row in rows]
            assert not [each for each in found if each[1]], drops
            flagged += sum(bool(row["flags"]) for row in rows)
            clear += sum(not row["flags"] for row in rows)
    # A reader that flags everything would pass.
    assert clear > flagged / 2, (clear, flagged)


def test_soapy_free_running_transmitter_is_read_with_two_antennas(tmp_path, long_run):
    """Its clock is 20 ppm slower than the receiver's: a sample more in 125 frames."""
    scene = scene_of([(0.5, FORCE_N, FORCE_N, LOCATION_MM)], 400, 0.3, **SLOW)
    scene["environment"] = {"reader_clock": "free", "receive_antennas": 2}
    effects = {"snr_db": 20, "carrier_offset_hz": 800, "phase_noise_hz": 5}
    scene["simulation"] |= {"duration_s": 1.9, "seed": 8, **effects}
    (tmp_path / "scene.yaml").write_text(json.dumps(scene))
    simulate(load_scene(scene), tmp_path / "press")
    files = []
    for name in ("press", "press.antenna2"):
        codes = np.fromfile(tmp_path / f"{name}.sigmf-data", "<u4")
        guard = np.arange(125, len(codes) // FRAME, 125) * FRAME - 5
        files.append(tmp_path / f"{name}.ci16")
        np.insert(codes, guard, codes[guard])[137:].tofile(files[-1])
    arguments = f"time=0,tx=0,file2={files[1]}"
    options = ["-o", tmp_path / "out.csv", "--record", tmp_path / "kept", "--duration", 1.6]
    run = start(tmp_path / "scene.yaml", files[0], arguments, *options)
    alone = [*run[:-6], "-o", str(tmp_path / "never.csv")]
    # With --long, the transmitter is another device.
    sender = ["--tx-args", "driver=player,full=0"] if long_run else ["--receive-only"]
    statuses, said = run_session("refused", json.dumps([*run, *sender]), json.dumps(alone))
    assert statuses == [0, 2], said
    assert "--args: must name a full-duplex device: this one receives only" in said
    clear = [row for row in rows_of(tmp_path / "out.csv") if not row["flags"]]
    touched = [row for row in clear if row["touch"] == "1"][3:-3]
    assert len(touched) >= 15 and clear[-1]["touch"] == clear[0]["touch"] == "0"
    for name, true in (("force_n", FORCE_N), ("location_mm", LOCATION_MM)):
        errors = [float(row[name]) - true for row in touched]
        stds = [float(row[name.replace("_", "_std_")]) for row in touched]
        assert np.all(np.abs(errors) < 4 * np.array(stds)), name
        assert np.median(stds) < (1.0 if name == "force_n" else 0.5)
    # Both antennas are recorded as they were received.
    sizes = [(tmp_path / f"{name}.sigmf-data").stat().st_size for name in ("kept", "kept.antenna2")]
    assert sizes[0] == sizes[1] > 4 * 1.5 * RATE


def test_soapy_radio_of_12_bits_is_used_to_its_full_scale(played, tmp_path):
    """Integers were sent beyond its range, and received as if they were 24 dB lower."""
    scene, file = played
    sent, arguments = tmp_path / "sent", f"bits=12,sent={tmp_path / 'sent'}"
    options = ["--record", tmp_path / "kept", "--duration", 0.4, "--amplitude", 0.91]
    (status,), said = run_session("refused", json.dumps(start(scene, file, arguments, *options)))
    assert status == 0, said
    assert int(sent.read_text()) in (2046, 2047)
    kept = np.fromfile(tmp_path / "kept.sigmf-data", "<i2")
    codes = np.fromfile(file, "<i2") // 16 * 16
    assert len(kept) > 0.3 * 2 * RATE
    at = next(n for n in range(0, 40_000, 2) if np.array_equal(codes[n : n + 100], kept[:100]))
    np.testing.assert_array_equal(kept, codes[at : at + len(kept)])


def test_soapy_arguments_without_a_module_are_refused():
    with pytest.raises(InputError, match="^--args: must name the SoapySDR module, as driver=lime"):
        soapy._check_arguments("--args", "addr=127.0.0.254")
