# SPDX-License-Identifier: GPL-3.0-or-later
"""Live reading in a room that the scene does not describe."""

import json

import pytest
import zmq
from live_runs import GAINS, SLOW, ask, connected, free_ports, live, rows_of, scene_of, wait_until
from software_usrp import SoftwareUsrp

CLOCK_HZ = 540
PRESS = (1.0, 4.0, 4.0, 45.0)


def test_live_room_is_surveyed_in_the_reference_and_reported(tmp_path):
    """An unlisted tag and lamps must not make live readings wrong, nor stay unsaid."""
    scene = scene_of([PRESS], CLOCK_HZ, **SLOW)
    scene["simulation"] |= {
        "other_tags": [{"clock_hz": 670, "level_db": -5, "delay_s": 2e-8}],
        "lamps": {"mains_hz": 50, "level_db": 0},
    }
    path, output, (port,) = tmp_path / "scene.json", tmp_path / "out.csv", free_ports(1)
    path.write_text(json.dumps(scene))
    device = SoftwareUsrp(path)
    try:
        with (
            live(device.args, path, *GAINS, "-o", output, "--control", port) as process,
            connected(zmq.REQ, port) as client,
        ):
            wait_until(lambda: ask(client, "status")["time_s"] > 2.2)
            status = ask(client, "status")
            ask(client, "stop")
            _, said = process.communicate(timeout=300)
    finally:
        device.stop()
    assert process.returncode == 0
    by_kind = {finding["kind"]: finding for finding in status["room"]}
    assert by_kind["tag"]["frequency_hz"] == pytest.approx(670, abs=0.5)
    assert by_kind["lamps"]["frequency_hz"] == 50
    assert "gr-wiforce: room: tag with a clock of 67" in said and "room: lamps on 50 Hz" in said
    rows = rows_of(output)
    assert status["gaps"] == 0 and all("gap" not in row["flags"] for row in rows)
    steady = [row for row in rows if 1.25 < float(row["time_s"]) < 1.75]
    assert len(steady) >= 14 and all((row["touch"], row["flags"]) == ("1", "") for row in steady)
    for row in steady:
        assert abs(float(row["force_n"]) - 4.0) < 0.2 + 4 * float(row["force_std_n"])
        assert abs(float(row["location_mm"]) - 45.0) < 0.5
