# SPDX-License-Identifier: GPL-3.0-or-later
"""Live runs through SoapySDR, on the software N210 by way of SoapyUHD."""

import signal

import numpy as np
import pytest
from live_runs import (
    GAINS,
    SLOW_GROUP_S,
    live,
    rows_of,
    streaming_s,
    wait_until,
)

SOAPY = ["--driver", "soapy"]
LOST = 3630


def column(rows, name):
    return np.array([float(row[name] or "nan") for row in rows])


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
