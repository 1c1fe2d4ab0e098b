# SPDX-License-Identifier: GPL-3.0-or-later
"""UHD's own programs, unmodified, against the software N210."""

import re
import subprocess
from pathlib import Path

from live_runs import FRAMES

EXAMPLES = Path("/usr/libexec/uhd/examples")


def run(program, *arguments, attempts=1):
    """Output of a program that must exit 0 within ``attempts`` runs."""
    path = EXAMPLES / program
    command = [str(path) if path.exists() else program, *map(str, arguments)]
    for _ in range(attempts):
        done = subprocess.run(
            command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60
        )
        if done.returncode == 0:
            break
    assert done.returncode == 0, done.stdout
    return done.stdout


def counts(output):
    """Figures of benchmark_rate's summary by name."""
    return {name: int(value) for name, value in re.findall(r"Num (.+?): +(\d+)", output)}


def test_uhd_find_and_probe_report_an_n210(software_usrp):
    device = software_usrp("--air", "cable")
    found = run("uhd_find_devices", f"--args={device.args}")
    assert f"addr: {device.address}" in found and "type: usrp2" in found
    probe = run("uhd_usrp_probe", f"--args={device.args}")
    assert "Mboard: N210r4" in probe
    assert re.search(r"RX Dboard: A\n.*ID: SBX ", probe), probe


def test_uhd_timed_commands_act_on_their_tick(software_usrp):
    device = software_usrp("--air", "cable")
    output = run("test_timed_commands", "--args", device.args, attempts=3)
    differences = re.findall(r"(?:time delta|time and first packet): +(-?[\d.]+) us", output)
    assert len(differences) == 2 and all(float(us) == 0 for us in differences), output


def test_uhd_benchmark_rate_at_full_rate_loses_nothing(software_usrp):
    device = software_usrp("--air", "cable")
    arguments = f"{device.args},{FRAMES}"
    rates = ["--rx_rate", 12.5e6, "--tx_rate", 12.5e6, "--duration", 2]
    limits = [f"--{kind}-threshold=0" for kind in ("overrun", "underrun", "drop", "seq")]
    summary = counts(run("benchmark_rate", "--args", arguments, *rates, *limits))
    moved = {"received samples", "transmitted samples"}
    # A busy machine moves less in two seconds of wall time, or waits too long, but loses nothing.
    assert all(summary[name] > 3e5 for name in moved), summary
    lost = {n: v for n, v in summary.items() if n not in moved and not n.startswith("timeouts")}
    assert lost and not any(lost.values()), summary
    status = device.command("status")
    assert status["tx_sequence_errors"] == status["malformed"] == status["foreign"] == 0
