# SPDX-License-Identifier: GPL-3.0-or-later
"""Live runs through SoapySDR, on the software N210 by way of SoapyUHD."""

import json
import signal

import numpy as np
import pytest
from gnuradio.wiforce.io.capture import open_capture
from live_runs import (
    FRAMES,
    GAINS,
    SLOW,
    SLOW_GROUP_S,
    command,
    live,
    rows_of,
    run_session,
    scene_file,
    scene_of,
    streaming_s,
    wait_until,
)
from software_usrp import SoftwareUsrp

SOAPY = ["--driver", "soapy"]
LOST = 3630
REFERENCE = 12  # groups


def run_of(device, scene, folder, *options):
    """Readings of a run of 2 s, and what it says."""
    args = f"driver=uhd,{device.args}" if options else device.args
    output = folder / ("soapy.csv" if options else "uhd.csv")
    options = [*GAINS, *options, "-o", output, "--record", output.with_suffix("")]
    with live(args, scene, *options, "--duration", 1.9) as process:
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0, said
    return rows_of(output), said


def overflowing(folder, *options):
    """A run with an overflow: where it was recorded, its readings, and what it said."""
    scene = scene_file(folder, [(0.7, 4.0, 4.0, 45.0)], 400, 0.4, **SLOW)
    device = SoftwareUsrp(scene, faults=[f"+1.2 overflow {LOST}"])
    try:
        return folder, *run_of(device, scene, folder, *options)
    finally:
        device.stop()


@pytest.fixture(scope="module")
def through_soapy(tmp_path_factory):
    return overflowing(tmp_path_factory.mktemp("soapy"), *SOAPY)


def column(rows, name):
    return np.array([float(row[name] or "nan") for row in rows])


@pytest.mark.long
def test_soapy_gives_the_readings_of_uhd(through_soapy, tmp_path):
    """Streams start at another time of the scene: the press comes up to 0.1 s earlier or later."""
    _, by_uhd, _ = overflowing(tmp_path)
    _, by_soapy, _ = through_soapy
    clear = [
        [row for row in rows if row["touch"] == "1" and not row["flags"]]
        for rows in (by_uhd, by_soapy)
    ]
    assert min(map(len, clear)) >= 18
    for name, true in (("force_n", 4.0), ("location_mm", 45.0)):
        held = [np.median(column(rows, name)[3:-3]) for rows in clear]
        assert held == pytest.approx([true, true], rel=0.04)
        spread = [np.std(column(rows, name)[3:-3]) for rows in clear]
        # Noise of the press and of the reference, which is another one in each stream.
        error = np.hypot(*spread) * np.sqrt(1 / (len(clear[0]) - 6) + 1 / REFERENCE)
        assert abs(held[0] - held[1]) < 4 * error + 0.002 * true
    # It holds how far the untouched line may drift by what the few groups before the press show,
    # which differs by 12 % from one start to the next. In one of five, another explanation of how
    # the press began stays likely, which widens it by 2.5.
    stds = [np.median(column(rows, "force_std_n")[3:-3]) for rows in clear]
    assert 0.25 < stds[0] / stds[1] < 4
    untouched = [np.nanmean(column(rows, "snr_db")) for rows in (by_uhd, by_soapy)]
    assert untouched[0] == pytest.approx(untouched[1], abs=0.3)


def test_soapy_overflow_is_one_gap_of_the_samples_lost(through_soapy):
    folder, rows, said = through_soapy
    assert f"1 gap, {LOST} samples lost" in said.splitlines()[-1]
    # In one group, or in two where it lies between them: streams start at another time each.
    assert sum("gap" in row["flags"] for row in rows) in (1, 2)
    assert np.allclose(column(rows, "time_s"), SLOW_GROUP_S * (np.arange(len(rows)) + 0.5))
    assert all(row["time_utc"] for row in rows)
    capture = open_capture(folder / "soapy")
    assert capture.span - capture.samples == LOST and len(capture.segments) == 2
    fields = json.loads((folder / "soapy.sigmf-meta").read_text())["global"]
    assert "N210" in fields["core:hw"] and "soapy" not in fields["core:hw"]
    assert fields["wiforce:rx_gain_db"] == fields["wiforce:tx_gain_db"] == 15


@pytest.mark.long
def test_soapy_device_lost_is_opened_again_on_the_frames_that_it_had(
    software_usrp, slow_scene, tmp_path
):
    """Its streams start apart, so that the frames come at another sample each time."""
    first = software_usrp(slow_scene)
    output = tmp_path / "out.csv"
    options = [*SOAPY, *GAINS, "--reconnect", "-o", output]
    with live(f"driver=uhd,{first.args}", slow_scene, *options) as process:
        wait_until(lambda: streaming_s(first) > 0.9)
        first.process.kill()
        first.process.wait()
        second = software_usrp(slow_scene, address=first.address)
        wait_until(lambda: streaming_s(second) > 1.4)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0 and "terminate" not in said
    assert "is back after" in said and "frame timing" not in said
    rows = rows_of(output)
    assert np.allclose(column(rows, "time_s"), SLOW_GROUP_S * (np.arange(len(rows)) + 0.5))
    absent = [row["flags"] == "gap" for row in rows]
    first_absent = absent.index(True)
    assert all({"gap", "moved"} & set(row["flags"].split()) for row in rows[first_absent:])
    # The tag is received again, as well as before.
    snr_db = column(rows, "snr_db")
    assert np.nanmean(snr_db[-5:]) == pytest.approx(np.nanmean(snr_db[:first_absent]), abs=1)


@pytest.mark.long
def test_soapy_without_reconnect_a_lost_device_ends_the_run(software_usrp, slow_scene, tmp_path):
    device = software_usrp(slow_scene)
    output = tmp_path / "out.csv"
    with live(f"driver=uhd,{device.args}", slow_scene, *SOAPY, *GAINS, "-o", output) as process:
        wait_until(lambda: streaming_s(device) > 0.6)
        device.process.kill()
        _, said = process.communicate(timeout=300)
    assert process.returncode == 1
    assert "is lost" in said or "has sent no samples" in said or "cannot be reached" in said
    assert said.splitlines()[-1].endswith("all readings until then are kept")
    assert len(rows_of(output)) >= 10


@pytest.mark.long
def test_soapy_impossible_settings_refused_in_one_line(slow_device, slow_scene, tmp_path):
    args = f"driver=uhd,{slow_device.args}"
    odd_rate = scene_of(
        [], clock_hz=400, radio={"sample_rate_hz": 2.6e6}, sounding={"frame_length": 400}
    )
    (tmp_path / "rate.yaml").write_text(json.dumps(odd_rate))
    start = ["--scene", slow_scene, *SOAPY, "--args"]
    cases = [
        ([*start, "driver=none"], ["--args", "driver=none", "module"]),
        ([*start, "driver=uhd,type=usrp2,addr=127.0.0.254"], ["no device found", "emulate"]),
        ([*start, args, "--rx-gain", 99], ["--rx-gain", "38"]),
        ([*start, args, "--antenna", "J1"], ["--antenna", "RX2"]),
        ([*start, args, "--bandwidth", 1e6], ["--bandwidth", "40"]),
        (
            ["--scene", tmp_path / "rate.yaml", *SOAPY, "--args", args],
            ["sample_rate_hz", "2600000"],
        ),
    ]
    statuses, said = run_session("refused", *(json.dumps(case, default=str) for case, _ in cases))
    assert statuses == [2] * len(cases)
    for line, (_, words) in zip(said.splitlines(), cases, strict=True):
        assert all(word in line for word in words), line


@pytest.mark.long
def test_soapy_check_measures_levels_and_clock(slow_scene, slow_device):
    args = f"driver=uhd,{slow_device.args},{FRAMES}"
    check = ["check", "--scene", slow_scene, *SOAPY, "--args", args, "--json", *GAINS]
    status, out, said = command(*check)
    assert (status, said) == (0, ""), said
    found = json.loads(out)
    assert found["levels"]["peak_dbfs"] == pytest.approx(-3, abs=1)
    (arm,) = found["sensors"]
    assert arm["clock_offset_ppm"] == pytest.approx(40, abs=4)
    assert found["advice"] == [] and found["room"] == []
    assert any("delay differs from start to start" in note for note in found["notes"])
    assert "N210" in found["hardware"]
