# SPDX-License-Identifier: GPL-3.0-or-later
"""State and health of a live reader, and tares at unfavourable moments."""

import json
import re
import statistics
import time
from datetime import datetime
from itertools import pairwise

import pytest
import zmq
from command_runs import run_command
from live_runs import GAINS, ask, connected, free_ports, live, wait_until


def until(subscriber, wanted):
    """Messages up to the first one that is wanted."""
    messages = [json.loads(subscriber.recv_string())]
    while not wanted(messages[-1]):
        messages.append(json.loads(subscriber.recv_string()))
    return messages


def steps_s(messages):
    """Seconds of UTC between messages."""
    utc_s = [datetime.fromisoformat(each["time_utc"]).timestamp() for each in messages]
    return [after - before for before, after in pairwise(utc_s)]


def touching(touch):
    return lambda m: m["message"] == "reading" and m["touch"] == touch


def settled(touch):
    """Not in a group in which the press changed."""
    return lambda m: touching(touch)(m) and not m["flags"]


def starved(message):
    """A busy machine may get no samples for a second."""
    return "no samples" in message["reason"]


def healthy(status):
    return status.returncode == 0 and status.stdout.splitlines()[-1] == "healthy"


def doubted(status):
    """Until a group that the emulator sent in part, or a release, decides."""
    return status.returncode == 1 and "reference was measured or forced" in status.stdout


def in_state(state):
    return lambda m: m["message"] == "heartbeat" and m["state"] == state


def test_live_reports_its_state_its_tares_its_tags_and_its_end(slow_scene, software_usrp, tmp_path):
    """A tare during a press once answered ok, and the press was read as no touch."""
    device = software_usrp(slow_scene, speed=2)
    readings_port, control_port = free_ports(2)
    output = tmp_path / "out.jsonl"
    options = ["--zmq", readings_port, "--control", control_port, "-o", output, *GAINS]
    assert run_command("status", control_port, "--timeout", 0.2).returncode == 1
    with (
        live(device.args, slow_scene, *options) as process,
        connected(zmq.SUB, readings_port) as subscriber,
        connected(zmq.REQ, control_port) as client,
    ):
        subscriber.subscribe("")
        messages = until(subscriber, in_state("reading"))
        for _ in range(4):
            messages += until(subscriber, in_state("reading"))
        # A busy machine delays single ones.
        assert statistics.median(steps_s(m for m in messages if in_state("reading")(m))) < 1.0
        wait_until(lambda: healthy(run_command("status", control_port)))
        device.command("press arm 5.0 40.0")
        messages += until(subscriber, settled(1))
        refused = ask(client, "tare")
        assert refused["ok"] is False and refused["state"] == "refused"
        assert re.search(r"arm is touched \(.* N at (39|40)\.\d mm\)", refused["reason"])
        forced = ask(client, "tare force")
        assert forced["ok"] and forced["forced"]
        # From the first group on that is compared with the new reference.
        wait_until(lambda: doubted(run_command("status", control_port, "--json")))
        device.command("release arm")
        messages += until(subscriber, settled(0))
        complete = ask(client, "tare")
        assert complete["ok"] and complete["state"] == "complete" and not complete["forced"]
        assert ask(client, "status")["tare"]["state"] == "complete"
        device.command("fault 0 off arm")
        messages += until(subscriber, lambda m: in_state("lost")(m) and not starved(m))
        lost = messages[-1]
        assert lost["reason"] == "not received: arm" and not lost["sensors"]["arm"]["received"]
        done = run_command("status", control_port, "--json", "--timeout", 60)
        found = json.loads(done.stdout)
        assert done.returncode == 1 and not found["healthy"] and found["state"] == "lost"
        device.command("fault 0 on arm")
        messages += until(subscriber, in_state("reading"))
        messages += until(subscriber, touching(0))
        assert ask(client, "stop") == {"ok": True}
        messages += until(subscriber, lambda m: m["message"] == "end")
        _, said = process.communicate(timeout=300)
    assert process.returncode == 0 and "arm is not received since" in said
    tares = [line.split()[2] for line in said.splitlines() if ": tare " in line]
    assert tares[:2] == ["refused:", "complete"]
    beats = [m for m in messages if m["message"] == "heartbeat" and not starved(m)]
    # What took less than the 50 ms between two looks at the state, or when the machine was busy, is
    # not sent; a tare measures a reference again.
    states = [m["state"] for m in beats if m["state"] not in ("acquiring", "reference")]
    assert list(dict.fromkeys(states)) == ["waiting", "reading", "lost", "ending"]
    end = messages[-1]
    assert (end["state"], end["reason"], end["exit_status"]) == ("ended", "request", 0)
    (run,) = {m["run"] for m in messages}
    rows = [json.loads(line) for line in output.read_text().splitlines()]
    assert {row["run"] for row in rows} == {run}
    published = {m["time_s"]: m for m in messages if m["message"] == "reading"}
    assert all(published[r["time_s"]]["time_utc"] == r["time_utc"] for r in rows[-3:])
    period_s = rows[1]["time_s"] - rows[0]["time_s"]
    # Where the software N210 falls behind, UTC goes on, and single steps are longer.
    assert statistics.median(steps_s(rows)) == pytest.approx(period_s, abs=0.05)
    assert abs(datetime.fromisoformat(rows[-1]["time_utc"]).timestamp() - time.time()) < 30
    # No row states a wrong touch without a flag: at least 3 N were on the line then.
    forces = [row["force_n"] for row in rows if row["touch"] == 1 and not row["flags"]]
    assert forces and min(forces) > 2.0
