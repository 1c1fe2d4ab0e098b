# SPDX-License-Identifier: GPL-3.0-or-later
"""State and health of a live reader, and tares at unfavourable moments."""

import json
import re
import time
from datetime import datetime

import pytest
import zmq
from live_runs import GAINS, SLOW, ask, command, connected, free_ports, live, rows_of, scene_file
from software_usrp import SoftwareUsrp

REFERENCE_S = 1.0


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    return scene_file(tmp_path_factory.mktemp("health"), [], 400, REFERENCE_S, **SLOW)


@pytest.fixture(scope="module")
def device(scene):
    device = SoftwareUsrp(scene)
    yield device
    device.stop()


def until(subscriber, wanted):
    """Messages up to the first one that is wanted."""
    messages = [json.loads(subscriber.recv_string())]
    while not wanted(messages[-1]):
        messages.append(json.loads(subscriber.recv_string()))
    return messages


def touching(touch):
    return lambda m: m["message"] == "reading" and m["touch"] == touch


def in_state(state):
    return lambda m: m["message"] == "heartbeat" and m["state"] == state


def test_live_tare_is_refused_fails_or_completes_and_its_reply_says_so(scene, device, tmp_path):
    """A tare during a press once answered ok, and the press was read as no touch."""
    readings_port, control_port = free_ports(2)
    output = tmp_path / "out.csv"
    options = ["--zmq", readings_port, "--control", control_port, "-o", output, *GAINS]
    with (
        live(device.args, scene, *options) as process,
        connected(zmq.SUB, readings_port) as subscriber,
        connected(zmq.REQ, control_port) as client,
    ):
        subscriber.subscribe("")
        until(subscriber, in_state("reading"))
        device.command("press arm 5.0 40.0")
        until(subscriber, touching(1))
        refused = ask(client, "tare")
        assert refused["ok"] is False and refused["state"] == "refused"
        assert re.search(r"arm is touched \(.* N at (39|40)\.\d mm\)", refused["reason"])
        assert all(m["touch"] == 1 for m in until(subscriber, in_state("reading"))[:-1])
        device.command("release arm")
        until(subscriber, touching(0))
        client.send_string("tare")
        until(subscriber, in_state("reference"))
        device.command("press arm 5.0 40.0")
        failed = json.loads(client.recv_string())
        assert failed["ok"] is False and failed["state"] == "failed"
        assert "arm was touched at" in failed["reason"] and "is kept" in failed["reason"]
        until(subscriber, touching(1))
        forced = ask(client, "tare force")
        assert forced["ok"] and forced["forced"]
        assert "forced" in ask(client, "status")["sensors"]["arm"]["doubt"]
        assert command("status", control_port)[0] == 1
        device.command("release arm")
        until(subscriber, lambda m: touching(0)(m) and not m["flags"])
        complete = ask(client, "tare")
        assert complete["ok"] and complete["state"] == "complete" and not complete["forced"]
        assert ask(client, "status")["tare"]["state"] == "complete"
        device.command("press arm 3.0 55.0")
        last = until(subscriber, lambda m: touching(1)(m) and not m["flags"])[-1]
        assert last["force_n"] == pytest.approx(3.0, abs=0.3)
        device.command("release arm")
        assert ask(client, "stop") == {"ok": True}
        _, said = process.communicate(timeout=60)
        assert process.returncode == 0
    assert [line.split()[2] for line in said.splitlines() if ": tare " in line] == [
        *("refused:", "failed:", "complete", "complete")
    ]
    # No row states a wrong touch without a flag: at least 5 N were on the line then.
    forces = [float(r["force_n"]) for r in rows_of(output) if r["touch"] == "1" and not r["flags"]]
    assert forces and min(forces) > 2.0


def test_live_reports_its_state_its_tags_and_its_end(scene, device, tmp_path):
    readings_port, control_port = free_ports(2)
    output = tmp_path / "out.jsonl"
    options = ["--zmq", readings_port, "--control", control_port, "-o", output, *GAINS]
    assert command("status", control_port, "--timeout", 0.2)[0] == 1
    with (
        live(device.args, scene, *options) as process,
        connected(zmq.SUB, readings_port) as subscriber,
        connected(zmq.REQ, control_port) as client,
    ):
        subscriber.subscribe("")
        messages = until(subscriber, in_state("reading"))
        beats_s = [time.monotonic()]
        for _ in range(4):
            messages += until(subscriber, in_state("reading"))
            beats_s.append(time.monotonic())
        assert max(b - a for a, b in zip(beats_s[:-1], beats_s[1:], strict=True)) < 1.0
        assert messages[-1]["sensors"]["arm"]["age_s"] < 1.0
        status, said, _ = command("status", control_port)
        assert status == 0 and said.splitlines()[-1] == "healthy"
        device.command("fault 0 off arm")
        messages += until(subscriber, in_state("lost"))
        lost = messages[-1]
        assert lost["reason"] == "not received: arm" and not lost["sensors"]["arm"]["received"]
        status, said, _ = command("status", control_port, "--json")
        found = json.loads(said)
        assert status == 1 and not found["healthy"] and found["state"] == "lost"
        device.command("fault 0 on arm")
        messages += until(subscriber, in_state("reading"))
        messages += until(subscriber, touching(0))
        assert ask(client, "stop") == {"ok": True}
        messages += until(subscriber, lambda m: m["message"] == "end")
        _, said = process.communicate(timeout=60)
    # On a busy machine samples may be late at the start.
    beats = [m for m in messages if m["message"] == "heartbeat" and "no samples" not in m["reason"]]
    states = [m["state"] for m in beats]
    assert list(dict.fromkeys(states)) == ["waiting", "acquiring", "reference", "reading", "lost"]
    end = messages[-1]
    assert (end["state"], end["reason"], end["exit_status"]) == ("ended", "request", 0)
    (run,) = {m["run"] for m in messages}
    rows = [json.loads(line) for line in output.read_text().splitlines()]
    assert {row["run"] for row in rows} == {run}
    published = {m["time_s"]: m for m in messages if m["message"] == "reading"}
    assert all(published[r["time_s"]]["time_utc"] == r["time_utc"] for r in rows[-3:])
    utc = [datetime.fromisoformat(row["time_utc"]).timestamp() for row in rows]
    steps = [b - a for a, b in zip(utc[:-1], utc[1:], strict=True)]
    period_s = rows[1]["time_s"] - rows[0]["time_s"]
    assert max(abs(step - period_s) for step in steps) < 0.05
    assert abs(utc[-1] - time.time()) < 30
    assert "arm is not received since" in said
    assert "arm is received again" in said and "continue from the former reference" in said
