# SPDX-License-Identifier: GPL-3.0-or-later
"""The command for 64-bit ARM: what can be checked without a cross compiler or an emulator."""

import os
import subprocess
import sys
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import SimpleNamespace

import pytest

PLATFORMS = Path(__file__).resolve().parent
HEADER = "time_s,sensor,touch,force_n,location_mm,phase1_deg,phase2_deg,flags\n"
READINGS = HEADER + "0.02,arm,0,,,-172.9,-172.9,\n0.06,arm,1,4.0,40.0,-120.0,-110.0,\n"


@pytest.fixture
def arm64(monkeypatch):
    monkeypatch.setattr(sys, "path", [str(PLATFORMS), *sys.path])
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    loader = SourceFileLoader("arm64", str(PLATFORMS / "arm64"))
    module = module_from_spec(spec_from_loader("arm64", loader))
    loader.exec_module(module)
    return module


def run(*words, **variables):
    command = [sys.executable, PLATFORMS / "arm64", *words]
    environment = os.environ | variables
    return subprocess.run(command, capture_output=True, text=True, timeout=60, env=environment)


def test_arm64_with_a_wrong_step_names_it_in_one_line():
    done = run("--steps", "create,fly")
    assert done.returncode == 2
    assert done.stderr.startswith("arm64: --steps must be some of create, compile, test, read")
    assert done.stderr.endswith("got 'fly'\n") and len(done.stderr.splitlines()) == 1


def test_arm64_without_its_programs_names_their_packages():
    """The compiler would be missed after a quarter of an hour."""
    done = run(PATH="/nowhere")
    assert done.returncode == 2
    assert "apt install g++-aarch64-linux-gnu mmdebstrap qemu-user-static" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_arm64_tests_that_are_not_compiled_are_not_passed(tmp_path, arm64, capsys):
    options = SimpleNamespace(folder=tmp_path, qemu="/bin/true")
    with pytest.raises(SystemExit, match="2"):
        arm64.test(options)
    assert "not compiled" in capsys.readouterr().err


def test_arm64_equal_readings_agree(tmp_path, arm64):
    (tmp_path / "here.csv").write_text(READINGS)
    (tmp_path / "there.csv").write_text(READINGS.replace("4.0,40.0", "4.0005,40.005"))
    outcome = arm64.compare(tmp_path, "there.csv")
    assert outcome.startswith("2 readings agree") and "force_n 0.0005" in outcome


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ("4.0,40.0", "4.1,40.0", "force_n differs by 0.1"),
        ("4.0,40.0", ",", "force_n at 0.06 s is ''"),
        ("arm,1", "arm,0", "touch at 0.06 s is '0'"),
        ("0.02,arm,0,,,-172.9,-172.9,\n", "", "1 readings in place of 2"),
    ],
)
def test_arm64_other_readings_are_refused(tmp_path, arm64, capsys, old, new, reason):
    """A test of another processor that compares nothing would always pass."""
    (tmp_path / "here.csv").write_text(READINGS)
    (tmp_path / "there.csv").write_text(READINGS.replace(old, new))
    with pytest.raises(SystemExit, match="2"):
        arm64.compare(tmp_path, "there.csv")
    assert reason in capsys.readouterr().err


def test_foreign_system_registers_nothing_for_the_machine(tmp_path, arm64):
    """Programs of the machine would be started by an emulator that is gone."""
    reason = arm64.why_not("/bin/true")
    if reason is not None:
        pytest.skip(reason)
    registrations = Path("/proc/sys/fs/binfmt_misc")
    before = sorted(path.name for path in registrations.iterdir())
    shown = subprocess.run(
        [*arm64.enter_command("/bin/true"), "cat", registrations / "wiforce-aarch64"],
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert shown.returncode == 0 and "interpreter /bin/true\nflags: OCF" in shown.stdout
    assert sorted(path.name for path in registrations.iterdir()) == before
