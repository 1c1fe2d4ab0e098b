# SPDX-License-Identifier: GPL-3.0-or-later
"""A live reader as a service: systemd's protocol and unit, the journal's levels, few log lines."""

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from wiforce_app.live.health import ServiceManager
from wiforce_app.live.radio_keeper import OPENING, RUNNING
from wiforce_app.shell.log import Log, WarningPace

ROOT = Path(__file__).resolve().parents[3]
UNIT = ROOT / "gr-wiforce/systemd/gr-wiforce-live@.service.in"


@pytest.fixture
def systemd(tmp_path):
    """A socket in place of systemd's, and the environment that it gives a service."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as server:
        server.bind(str(tmp_path / "notify"))
        server.setblocking(False)

        def messages():
            found = []
            while True:
                try:
                    found.append(server.recv(4096).decode())
                except BlockingIOError:
                    return found

        variables = {"NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "20000000"}
        yield SimpleNamespace(messages=messages, environment=variables)


def test_service_reports_readiness_state_and_life(systemd, capsys):
    now, session = [0.0], SimpleNamespace(behind_s=0.0)
    keeper = SimpleNamespace(state=OPENING, waits=False)
    service = ServiceManager(session, keeper, systemd.environment, lambda: now[0])
    assert systemd.environment == {}  # processes that are started must not report

    def after(seconds):
        for _ in range(round(seconds / 0.1)):
            now[0] += 0.1
            service.look()
        return systemd.messages()

    assert "READY=1" not in after(1.0)
    keeper.state = RUNNING
    assert "READY=1" in after(1.0)
    assert after(30.0).count("WATCHDOG=1") == 3  # at half of the limit
    # An output that takes no readings: systemd must notice, and the log say why.
    session.behind_s = 11.0
    capsys.readouterr()
    assert "WATCHDOG=1" not in after(60.0)
    assert capsys.readouterr().err.count("an output takes no readings") == 1
    session.behind_s = 0.0
    assert "WATCHDOG=1" in after(10.0)
    service.stopping()
    assert systemd.messages() == ["STOPPING=1"]
    service.close()


def test_service_waiting_for_an_absent_device_is_ready(systemd):
    """Otherwise systemd gives up a service whose device is switched on an hour later."""
    keeper = SimpleNamespace(state=OPENING, waits=True)
    for environment, reported in ((systemd.environment, True), ({}, False)):
        service = ServiceManager(SimpleNamespace(behind_s=0.0), keeper, environment)
        service.look()
        assert ("READY=1" in systemd.messages()) is reported
        service.close()


def test_log_lines_for_people_and_for_the_journal(capsys):
    log = Log()
    log.set_up("debug", "plain")
    for write in (log.error, log.warning, log.info, log.debug):
        write("text")
    assert capsys.readouterr().err.splitlines() == [
        "gr-wiforce: text",
        "gr-wiforce: warning: text",
        "gr-wiforce: text",
        "gr-wiforce: debug: text",
    ]
    log.set_up("warning", "journal")
    for write in (log.error, log.warning, log.info, log.debug):
        write("text")
    assert capsys.readouterr().err.splitlines() == ["<3>text", "<4>text"]


def test_command_failure_under_the_journal_has_its_level(tmp_path):
    with open(tmp_path / "journal", "w+") as stream:
        status = os.fstat(stream.fileno())
        subprocess.run(
            [sys.executable, "-c", "from wiforce_app.main import run; run()", "read", "absent"],
            env=os.environ | {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"},
            stderr=stream,
        )
        stream.seek(0)
        assert stream.read().startswith("<3>absent")


def test_warning_that_recurs_every_second_for_a_week_is_written_rarely():
    now = [0.0]
    pace = WarningPace(lambda: now[0])
    written = []
    for second in range(7 * 86400):
        now[0] = float(second)
        if pace.allows("gaps"):
            written.append(second)
    assert written[:6] == [0, 1, 3, 7, 15, 31]
    assert len(written) < 7 * 86400 / 500
    now[0] += 3600
    assert pace.allows("gaps")  # and one that comes again, soon
    now[0] += 1
    assert pace.allows("gaps")


def unit_settings():
    lines = UNIT.read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if "=" in line and not line.startswith("#"))


def test_unit_is_valid_and_its_options_are_options_of_live(tmp_path):
    from wiforce_app.live.live import live

    settings = unit_settings()
    known = {option for parameter in live.params for option in parameter.opts}
    words = settings["ExecStart"].split()
    assert {word for word in words if word.startswith("--")} <= known
    assert settings["Type"] == "notify" and settings["RestartPreventExitStatus"] == "2"
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is missing")
    unit = tmp_path / "gr-wiforce-live@.service"
    unit.write_text(UNIT.read_text().replace("@GR_WIFORCE_COMMAND@", sys.executable))
    done = subprocess.run(
        ["systemd-analyze", "verify", "--man=no", str(unit)], capture_output=True, text=True
    )
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
