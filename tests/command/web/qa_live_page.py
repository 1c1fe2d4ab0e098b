# SPDX-License-Identifier: GPL-3.0-or-later
"""``gr-wiforce live --web``: the page's process shows the readings, and never affects them."""

import contextlib
import gc
import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from live_runs import free_ports, live, rows_of, wait_until
from long_cases import cases
from machine import children, own_address
from web_pages import RawViewer, touched
from wiforce_app.web import live_page
from wiforce_app.web.address import PageAddress
from wiforce_app.web.sources import page_row


def first_viewer(url):
    """A viewer, as soon as the port is open."""
    found = []

    def connect():
        with contextlib.suppress(OSError):
            found.append(RawViewer(url))
        return found

    wait_until(connect)
    return found[0]


def cmdline(pid):
    """Empty for a process that has ended."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/cmdline").read_bytes()
    return b""


@pytest.mark.parametrize("ending", cases("signal", long=("killed",)))
def test_live_page_shows_all_readings_and_how_the_run_ends(
    slow_device, slow_scene, tmp_path, ending
):
    (port,) = free_ports(1)
    output = tmp_path / "readings.csv"
    options = ["--web", port, "-o", output]
    with live(slow_device.args, slow_scene, *options) as reader:
        with closing(first_viewer(f"http://127.0.0.1:{port}/")) as viewer:
            rows, statuses = [], []

            def take(message):
                assert message is not None, "the page has ended without a word"
                rows.extend(message["rows"])
                statuses.append(message.get("status", {}))

            while len(rows) < 20:
                take(viewer.message())
            (page,) = [child for child in children(reader) if b"live_page" in cmdline(child)]
            reader.send_signal(signal.SIGTERM if ending == "signal" else signal.SIGKILL)
            while ending == "signal" and statuses[-1].get("state") != "ended":
                take(viewer.message())
        last = [status for status in statuses if status][-1]
        assert ending == "killed" or last["reason"] == "signal"
        assert last["can_tare"] and last["sensors"]["arm"]["length_mm"] == 80.0
        wait_until(lambda: not cmdline(page))
        if ending == "signal":
            assert reader.wait(60) == 0
    written = [page_row(row) for row in rows_of(output)]
    first = next(n for n, row in enumerate(written) if row[1] == rows[0][1])
    assert rows == written[first : first + len(rows)]


# What Python imports first in a process that has it in PYTHONPATH.
BUSY = """
import sys, time
if any("live_page" in word for word in sys.orig_argv):
    time.sleep({})
"""


@pytest.mark.parametrize("busy_s", cases(0, long=(5,)))
def test_live_page_of_a_run_that_ends_at_once_says_why(slow_scene, tmp_path, monkeypatch, busy_s):
    """Its process starts later: a viewer got no answer, or "no messages from the reader yet"."""
    (tmp_path / "sitecustomize.py").write_text(BUSY.format(busy_s))
    found = [str(tmp_path), os.environ["PYTHONPATH"]]
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(found))
    (port,) = free_ports(1)
    args = f"addr={own_address()},type=usrp2"
    with live(args, slow_scene, "--web", port, "-o", tmp_path / "readings.csv") as reader:
        with closing(first_viewer(f"http://127.0.0.1:{port}/")) as viewer:
            *_, last = iter(viewer.message, None)
        assert reader.wait(60) == 2
    assert last["status"]["state"] == "ended" and "no device found" in last["status"]["reason"]


def test_live_page_whose_process_ends_is_reported_once(monkeypatch):
    """A run of weeks must not end with its page, nor repeat that it has gone."""

    def ends_at_once(*_):
        process = subprocess.Popen([sys.executable, "-S", "-c", "raise SystemExit(3)"])
        process.wait()
        return process

    monkeypatch.setattr(live_page, "spawned", ends_at_once)
    (port,), said = free_ports(1), []
    page = live_page.LivePage(PageAddress.of(str(port)), said.append)
    page._process.wait()
    for _ in range(3):
        page.write(touched(1.0), {"run": "r"})
        page.send("heartbeat", {"run": "r"})
    folder = Path(page.control.removeprefix("ipc://")).parent
    assert folder.stat().st_mode & 0o077 == 0
    page.close()
    assert said == ["the page has ended with status 3; readings go on"] and not folder.exists()


def test_live_page_interrupted_while_its_process_starts_leaves_nothing(monkeypatch, capfd):
    """Ctrl-C printed a traceback of the process, whose folder stayed."""
    started, folders, spawned, make = [], [], live_page.spawned, live_page.tempfile.mkdtemp

    def interrupted(*arguments):
        started.append(spawned(*arguments))
        raise KeyboardInterrupt

    def noted(**options):
        folders.append(Path(make(**options)))
        return str(folders[-1])

    monkeypatch.setattr(live_page, "spawned", interrupted)
    monkeypatch.setattr(live_page.tempfile, "mkdtemp", noted)
    (port,) = free_ports(1)
    with pytest.raises(KeyboardInterrupt):
        live_page.LivePage(PageAddress.of(str(port)), print)
    gc.collect()  # of what the traceback holds
    assert started[0].wait(60) == 0 and capfd.readouterr().err == ""
    assert not folders[0].exists()


def test_live_page_interrupted_while_it_closes_leaves_nothing(monkeypatch):
    (port,) = free_ports(1)
    page = live_page.LivePage(PageAddress.of(str(port)), print)
    folder = Path(page.control.removeprefix("ipc://")).parent
    wait = page._process.wait

    def interrupted(*limit):
        monkeypatch.setattr(page._process, "wait", wait)
        raise KeyboardInterrupt

    monkeypatch.setattr(page._process, "wait", interrupted)
    with pytest.raises(KeyboardInterrupt):
        page.close()
    assert page._process.poll() is not None and not folder.exists()
