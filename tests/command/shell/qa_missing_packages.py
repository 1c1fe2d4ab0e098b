# SPDX-License-Identifier: GPL-3.0-or-later
"""A package that one feature needs is named in one line where it is missing."""

import sys

import numpy as np
import pytest
from command_runs import run_command
from gnuradio.wiforce.calibration.tables import read_touchstone_index
from gnuradio.wiforce.errors import InputError, gnuradio_rule
from wiforce_app.shell.workers import _connect

LIVE = ("live", "--scene", "demo", "--args", "addr=127.0.0.9")
READ = ("read", "raw", "--scene", "demo", "--datatype", "cf32_le")
MCAP = "mcap-ros2-support"
ZMQ = "pyzmq: apt install python3-zmq, or pip install pyzmq"
PLOT = "matplotlib: apt install python3-matplotlib, or pip install matplotlib"
ARROW = 'pyarrow<24: pip install "pyarrow<24"'
BOTH = f"foxglove-sdk and {MCAP}: pip install foxglove-sdk {MCAP}"

FEATURES = [
    ([*READ, "--mcap", "o.mcap"], "mcap_ros2", f"o.mcap: needs {MCAP}: pip install {MCAP}"),
    ([*READ, "-o", "o.parquet"], "pyarrow", f"o.parquet: needs {ARROW}"),
    ([*READ, "--plot", "o.png"], "matplotlib", f"o.png: needs {PLOT}"),
    (["export", "in.csv", "--to", "mcap"], "mcap_ros2", f"needs {MCAP}: pip install {MCAP}"),
    (["export", "in.csv", "--to", "parquet"], "pyarrow", f"needs {ARROW}"),
    (["export", "in.parquet", "--to", "csv"], "pyarrow", f"in.parquet: needs {ARROW}"),
    (["export", "in.mcap", "--to", "csv"], "mcap", f"in.mcap: needs {MCAP}: pip install {MCAP}"),
    ([*LIVE, "--mcap", "o.mcap"], "mcap_ros2", f"o.mcap: needs {MCAP}: pip install {MCAP}"),
    ([*LIVE, "--foxglove", "8765"], "foxglove mcap_ros2", f"--foxglove: needs {BOTH}"),
    ([*LIVE, "--lsl"], "pylsl", "--lsl: needs pylsl: pip install pylsl"),
    ([*LIVE, "-o", "o.parquet"], "pyarrow", f"o.parquet: needs {ARROW}"),
    ([*LIVE, "--zmq", "5555"], "zmq", f"--zmq: needs {ZMQ}"),
    ([*LIVE, "--web", "8080"], "bokeh", "--web: needs bokeh: pip install bokeh"),
    (["status", "5556"], "zmq", f"needs {ZMQ}"),
    (["keys", "keys"], "zmq", f"keys: needs {ZMQ}"),
]


def remove(modules, monkeypatch):
    """Make imports of these fail."""
    for module in modules.split():
        for name in [name for name in sys.modules if name.split(".")[0] == module]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.setitem(sys.modules, module, None)


@pytest.mark.parametrize(("words", "modules", "rule"), FEATURES)
def test_missing_package_is_named_in_one_line(tmp_path, monkeypatch, words, modules, rule):
    """Nothing else needs it, so a traceback would be the first that a user hears of it."""
    remove(modules, monkeypatch)
    (tmp_path / "in.csv").write_text("time_s,sensor\n0.1,arm\n")
    (tmp_path / "in.parquet").write_bytes(b"PAR1")
    (tmp_path / "in.mcap").write_bytes(b"")
    np.zeros(1000, np.complex64).tofile(tmp_path / "raw")
    before = sorted(tmp_path.iterdir())
    done = run_command(*words, cwd=tmp_path)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert done.stderr.endswith(f"{rule}\n"), done.stderr
    assert [path for path in tmp_path.iterdir() if path.is_file() and path not in before] == []


def test_missing_package_of_clusters_is_named_before_anything_is_connected(monkeypatch):
    remove("distributed", monkeypatch)
    rule = "--scheduler: needs distributed: apt install python3-distributed, or pip install"
    with pytest.raises(InputError, match=rule):
        _connect("tcp://127.0.0.1:8786")


@pytest.mark.parametrize("module", ["SoapySDR", "gnuradio.soapy"])
def test_missing_soapy_is_named_in_one_line(monkeypatch, module):
    """It is imported in the process of the radio, whose traceback would end in nobody's hands."""
    from wiforce_app.radio import soapy

    if module in sys.modules:
        monkeypatch.delitem(sys.modules, module)
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(InputError, match=r"^--driver: 'soapy' needs .*python3-soapysdr") as raised:
        soapy._libraries()
    assert "\n" not in str(raised.value)


def test_missing_package_of_touchstone_files_is_named(tmp_path, monkeypatch):
    remove("skrf", monkeypatch)
    (tmp_path / "index.csv").write_text("file,force_n,location_mm\npress.s2p,2,40\n")
    with pytest.raises(InputError, match='row 2: needs scikit-rf>=1.0: pip install "scikit-rf'):
        read_touchstone_index(tmp_path / "index.csv", 900e6)


@pytest.mark.parametrize(
    ("statement", "needed"),
    [
        ("from gnuradio.wiforce.sensor.tables import absent", False),
        ("import gnuradio.wiforce.sensor.absent", False),
        ("import gnuradio.wiforce.absent", False),
        ("from gnuradio import absent", True),
        ("import gnuradio.absent", True),
        ("import pmt.absent", True),
    ],
)
def test_import_error_within_the_package_is_not_reported_as_missing_gnuradio(statement, needed):
    """A mistake in our code would send users to install what they have."""
    with pytest.raises(ImportError) as caught:
        exec(statement, {})
    assert (gnuradio_rule(caught.value) is not None) == needed
