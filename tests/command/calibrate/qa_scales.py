# SPDX-License-Identifier: GPL-3.0-or-later
"""Forces of a guided calibration from a CSV stream or a serial scale."""

import os
import subprocess
import sys
import time

import pytest
from gnuradio.wiforce.errors import InputError
from wiforce_app.calibrate.guide import open_scale


def latest(scale, since_s):
    """Force after what has arrived is taken."""
    scale.poll()
    return scale.gauge.mean(since_s, time.monotonic())[0]


def test_csv_pipe_gives_forces_as_they_are_written(tmp_path):
    os.mkfifo(tmp_path / "forces")
    scale = open_scale(str(tmp_path / "forces"), "N", 9600)
    scale.poll()  # nobody writes yet
    with open(tmp_path / "forces", "w", buffering=1) as stream:
        begin_s = time.monotonic()
        stream.write("time_s,force_n\n0.0,2.5\n0.1,2.")
        stream.flush()
        assert latest(scale, begin_s) == 2.5
        stream.write("52\n")
        assert latest(scale, begin_s) == pytest.approx(2.51)
    scale.close()


def test_csv_pipe_that_never_pauses_is_read_in_parts(tmp_path):
    """The dialogue would hang: a writer may be faster than its reader."""
    os.mkfifo(tmp_path / "forces")
    scale = open_scale(str(tmp_path / "forces"), "N", 9600)
    writing = f"exec > {tmp_path}/forces; echo force_n; exec yes 3.0"
    with subprocess.Popen(["sh", "-c", writing]) as writer:
        begin_s = time.monotonic()
        while not scale.gauge.heard_since(begin_s):
            scale.poll()
        assert latest(scale, begin_s) == 3.0
        writer.kill()
    scale.close()


def test_csv_file_gives_rows_that_are_added_only(tmp_path):
    """Yesterday's forces would be taken as measured now."""
    path = tmp_path / "forces.csv"
    path.write_text("force_n\n9.0\n")
    scale = open_scale(str(path), "N", 9600)
    begin_s = time.monotonic()
    scale.poll()
    assert not scale.gauge.heard_since(0.0)
    with open(path, "a") as stream:
        stream.write("3.0\n2 of 5\n")
    assert latest(scale, begin_s) == 3.0
    scale.close()


def test_csv_without_forces_and_unit_of_no_force_are_refused(tmp_path):
    path = tmp_path / "forces.csv"
    path.write_text("time_s,weight_g\n0,204\n")
    with pytest.raises(InputError, match="must have a header with a column force_n"):
        open_scale(str(path), "N", 9600)
    with pytest.raises(InputError, match="absent.csv: cannot be read"):
        open_scale(str(tmp_path / "absent.csv"), "N", 9600)
    with pytest.raises(InputError, match="--scale-unit: must be one of N, mN, kN, g, kg"):
        open_scale(str(tmp_path), "mm", 9600)


def test_serial_scale_gives_forces_in_its_unit():
    pytest.importorskip("serial")
    master, slave = os.openpty()
    scale = open_scale(f"serial:{os.ttyname(slave)}", "g", 19200)
    begin_s = time.monotonic()
    os.write(master, b"ST,GS,+  204.0\r\nST,GS,+  0.2")
    assert latest(scale, begin_s) == pytest.approx(2.0006, rel=1e-4)
    os.write(master, b"06 kg\r\n")
    assert latest(scale, begin_s) == pytest.approx(2.0104, rel=1e-4)
    scale.close()
    os.close(master)
    os.close(slave)


def test_serial_scale_names_what_is_missing(monkeypatch):
    with monkeypatch.context() as patched:
        patched.setitem(sys.modules, "serial", None)
        with pytest.raises(InputError, match="--scale: needs pyserial: apt install"):
            open_scale("serial:/dev/ttyUSB0", "N", 9600)
    pytest.importorskip("serial")
    with pytest.raises(InputError, match="must name a serial port"):
        open_scale("serial:/dev/no-such-port", "N", 9600)
