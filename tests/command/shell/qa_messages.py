# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages of typical mistakes: each says what to change, so that nobody needs to read it twice."""

import sys
from pathlib import Path

import numpy as np
import pytest
from command_runs import refused
from gnuradio.wiforce.calibration.tables import read_touchstone_index
from gnuradio.wiforce.errors import InputError, gnuradio_rule
from gnuradio.wiforce.io import optional
from wiforce_app.main import main

HEADER = "freq_mhz,location_mm,port,force_n,phase_deg\n"
CALIBRATE = "calibrate file.csv -o s.yaml"
PHASES = "phase1_deg,phase2_deg,"
# What is said of a file that holds this, by this command.
MISTAKES = {
    "is not a capture: there is no file.csv.sigmf-meta; for raw samples, give their type": (
        ("\0\1\2\3", "read file.csv")
    ),
    "file.csv: holds text, not samples; `export`, `score` and `watch` take files of readings": (
        ("time_s,sensor\n0.5,arm\n", "read file.csv")
    ),
    "is a file of a capture; a scene is a": (HEADER, "simulate press.sigmf-meta x"),
    "shipped scene (did you mean 'tabletop'? gr-wiforce list": (HEADER, "plan tabeltop"),
    "columns must be separated by commas, got ';'": (HEADER.replace(",", ";"), CALIBRATE),
    "with a decimal point, got '2,5'": (HEADER + '900,20,1,"2,5",5\n', CALIBRATE),
    "--frequency-hz: is missing: file.csv does not state its carrier; give it, as 915e6\n": (
        (PHASES + "force_n,location_mm\n1,2,3,4\n", f"{CALIBRATE} --kind taps")
    ),
    "row 2: freq_mhz: must be 1 to 100000 MHz (not in Hz or GHz), got 0.9": (
        (HEADER + "0.9,,1,0,30\n0.9,20,1,2,30\n", CALIBRATE)
    ),
    "folder: is a folder; name a file of the capture in it": (HEADER, "check folder"),
    "--length-mm: must be a number above 0 and at most": (
        (HEADER + "900,20,1,2,5\n", f"{CALIBRATE} --length-mm -5")
    ),
    "'': sensor file must end in .yaml": (HEADER, "calibrate file.csv -o "),
    "file.csv: location_mm: must lie from 9 to 71 mm, got 500.0": (
        (PHASES + "location_mm\n10,20,500\n", "invert file.csv --sensor line-900mhz")
    ),
    "force_n, phase_deg (missing: force_n), got 'freq_mhz,location_mm,port,force,": (
        (HEADER.replace("force_n", "force") + "900,20,1,2,30\n", CALIBRATE)
    ),
    "force_n, phase_deg (or give --frequency-hz), got 'location_mm,": (
        (HEADER.replace("freq_mhz,", "") + "20,1,2,30\n", CALIBRATE)
    ),
    "file.csv: is a sensor model; a scene lists its sensors": (
        ("kind: line\nname: arm\n", "plan file.csv")
    ),
    "line 2, column 1: a tab, but YAML is indented with": (
        ("radio:\n\tcenter_frequency_hz: 900e6\n", "plan file.csv")
    ),
}


@pytest.mark.parametrize("message", MISTAKES)
def test_message_of_a_mistake_says_what_to_change(tmp_path, monkeypatch, capsys, message):
    content, arguments = MISTAKES[message]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    (tmp_path / "file.csv").write_text(content)
    assert main(arguments.split(" ")) == 2
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1
    assert {path.name for path in tmp_path.iterdir()} == {"file.csv", "folder"}


def test_message_of_a_scene_in_place_of_a_sensor_names_both(tmp_path):
    (tmp_path / "scene.yaml").write_text("sensors: [{name: arm, model: line-900mhz}]")
    (tmp_path / "phases.csv").write_text("phase1_deg,phase2_deg\n1,2\n")
    said = refused("invert", "phases.csv", "--sensor", "scene.yaml", cwd=tmp_path)
    assert "scene.yaml: is a scene; a sensor" in said


@pytest.mark.parametrize("name", ["scene.yaml", "vna.csv", "readings.csv"])
def test_demo_file_of_the_user_is_never_replaced(tmp_path, monkeypatch, capsys, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text("precious")
    assert main(["demo", "--folder", "."]) == 2
    assert f"{name}: exists already and is not from an earlier demo" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_text() == "precious"


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
    (tmp_path / "in.mcap").write_bytes(b"\x89MCAP0\r\n")
    np.zeros(1000, np.complex64).tofile(tmp_path / "raw")
    before = sorted(tmp_path.iterdir())
    said = refused(*words, cwd=tmp_path)
    assert said.endswith(f"{rule}, or ./bootstrap in a checkout")
    assert [path for path in tmp_path.iterdir() if path.is_file() and path not in before] == []


@pytest.mark.parametrize("module", sorted(optional._PACKAGES))
def test_bootstrap_installs_each_package_for_which_it_is_named(module):
    """csiread was missing after the ./bootstrap that the message asked for."""
    script = (Path(__file__).parents[3] / "bootstrap").read_text()
    installed = script[script.index("packages=(") : script.index("# What only the tests need.")]
    debian, pypi = optional._PACKAGES[module]
    named = "./bootstrap" in str(optional._missing("FILE", [module]))
    assert named == (pypi.strip('"') in installed or str(debian) in installed)


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
