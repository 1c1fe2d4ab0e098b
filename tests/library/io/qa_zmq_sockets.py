# SPDX-License-Identifier: GPL-3.0-or-later
"""Requests over ZMQ: whatever a peer sends, the reader answers in JSON and goes on."""

import json
import socket
import subprocess
import sys
import threading
import time

import pytest
import zmq
from command_runs import run_command
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.zmq_sockets import (
    Later,
    ReadingsPublisher,
    Replies,
    answer_words,
    endpoint_of,
    request,
)
from gnuradio.wiforce.io.readings import Reading


@pytest.fixture
def free_port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@pytest.fixture
def ask(free_port):
    """Sends the parts of a request and gives the answer; None when there is none."""
    replies = Replies(str(free_port), answer_words({"status": lambda: {"groups": 3}}))

    def send(*parts):
        client = zmq.Context.instance().socket(zmq.REQ)
        client.connect(f"tcp://127.0.0.1:{free_port}")
        client.send_multipart(list(parts))
        answer = None
        for _ in range(20 if sum(map(len, parts)) > 4096 else 400):
            replies.serve(10)
            if client.poll(5):
                answer = json.loads(client.recv())
                break
        client.close(linger=0)
        return answer

    send.port, send.serve = free_port, replies.serve
    yield send
    replies.close()


def test_a_word_that_is_known_is_answered(ask):
    assert ask(b"status") == {"ok": True, "groups": 3}
    assert ask(b" status\n") == {"ok": True, "groups": 3}


def test_what_is_no_request_neither_stops_the_reader_nor_costs_another_its_answer(ask):
    # A message without an envelope, as the first version of the protocol has it.
    with socket.create_connection(("127.0.0.1", ask.port)) as stranger:
        stranger.sendall(b"\x01\x00" + b"\x06\x00hello")
        time.sleep(0.1)
        ask.serve(10)
    assert ask(b"status")["ok"]
    assert ask(b"\xff\xfe", b"", b"\x00")["ok"] is False
    assert ask(b"status")["ok"]


def test_a_request_too_long_is_cut_off_and_the_next_one_answered(ask):
    assert ask(b"status" * 100_000) is None
    assert ask(b"status")["ok"]


def test_answer_that_comes_later_is_sent_when_it_is_known(free_port):
    """A tare is answered when it is complete; others must not wait for it."""
    later, words = Later(), {}
    words["tare"] = lambda: later
    words["status"] = dict
    replies = Replies(str(free_port), answer_words(words))
    with (
        zmq.Context() as context,
        context.socket(zmq.REQ) as first,
        context.socket(zmq.REQ) as last,
    ):
        for client, word in ((first, b"tare"), (last, b"status")):
            client.setsockopt(zmq.LINGER, 0)
            client.connect(f"tcp://127.0.0.1:{free_port}")
            client.send(word)
        deadline = time.monotonic() + 60
        while not last.poll(5) and time.monotonic() < deadline:
            replies.serve(10)
        assert json.loads(last.recv()) == {"ok": True} and not first.poll(50)
        later.answer("complete")
        replies.close()
        assert first.poll(60_000) and first.recv() == b"complete"


def test_request_without_a_reader_ends_in_time(free_port):
    begin = time.monotonic()
    assert request(str(free_port), "status", 0.1) is None
    assert time.monotonic() - begin < 30


def test_localhost_is_bound_and_connected_to_as_loopback(free_port):
    """ZMQ itself binds to addresses only, and says 'No such device' for a name."""
    replies = Replies(f"tcp://localhost:{free_port}", str.upper)
    client = zmq.Context.instance().socket(zmq.REQ)
    client.connect(endpoint_of(f"tcp://localhost:{free_port}", "ENDPOINT"))
    client.send(b"hello")
    deadline = time.monotonic() + 60
    while not client.poll(5) and time.monotonic() < deadline:
        replies.serve(10)
    assert client.recv() == b"HELLO"
    client.close(linger=0)
    replies.close()


@pytest.mark.parametrize("host", ["nowhere.invalid", "192.0.2.1", "[::1]"])
def test_endpoint_of_another_machine_is_refused_with_the_rule(free_port, host):
    with pytest.raises(
        InputError, match="cannot be bound .ADDRESS must be an IPv4 address of this"
    ):
        ReadingsPublisher(f"tcp://{host}:{free_port}")


def test_endpoint_in_use_is_refused():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        with pytest.raises(InputError, match="--control: cannot be bound"):
            Replies(str(taken.getsockname()[1]), str.upper)


ATTACK = """
import sys, time, zmq
sockets = []
for peer in range(10):
    sockets.append(zmq.Context.instance().socket(zmq.SUB))
    sockets[-1].connect(sys.argv[1])
    for number in range(1000):
        sockets[-1].subscribe(f"{peer}-{number}-".ljust(int(sys.argv[2]), "x"))
print("sent", flush=True)
sys.stdin.read()
"""


def resident_bytes():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096


@pytest.mark.parametrize("length", [40, 400])
def test_publisher_memory_is_bounded_whatever_peers_subscribe_to(free_port, length):
    """10 000 subscriptions to 400 characters each took 117 MB that were never released."""
    publisher, address = ReadingsPublisher(str(free_port)), f"tcp://127.0.0.1:{free_port}"
    before = resident_bytes()
    command = [sys.executable, "-c", ATTACK, address, str(length)]
    with (
        subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as attacker,
        zmq.Context() as context,
        context.socket(zmq.SUB) as subscriber,
    ):
        attacked = threading.Thread(target=attacker.stdout.readline)
        attacked.start()
        while attacked.is_alive():
            publisher.send("heartbeat", {})
            time.sleep(0.01)
        for _ in range(100):
            publisher.send("heartbeat", {})
            time.sleep(0.01)
        assert resident_bytes() - before < 8e6
        attacker.stdin.close()
        subscriber.connect(address)
        subscriber.subscribe('{"message": "reading"')
        deadline = time.monotonic() + 60
        while not subscriber.poll(10):
            assert time.monotonic() < deadline
            publisher.take(Reading(0.018, "arm"), {"run": "1"})
        received = json.loads(subscriber.recv())
        assert (received["message"], received["sensor"], received["run"]) == ("reading", "arm", "1")
    publisher.close()


@pytest.mark.parametrize(
    ("answer", "status", "words"),
    [
        (b"READY", 2, "must be the --control endpoint of a reader of this version"),
        (b'["reading"]', 2, "must be the --control endpoint of a reader of this version"),
        (b'{"ok": true, "state": "reading", "sensors": {"arm": {}}}', 2, "it answers otherwise"),
        (b'{"ok": false, "error": "100 requests wait"}', 1, "status refused: 100 requests wait"),
    ],
)
def test_status_of_what_is_no_reader_is_one_line(free_port, answer, status, words):
    """A port that was mixed up must not look like a fault of the program."""
    with zmq.Context() as context, context.socket(zmq.REP) as server:
        server.setsockopt(zmq.LINGER, 0)
        server.bind(f"tcp://127.0.0.1:{free_port}")
        answering = threading.Thread(target=lambda: server.recv() and server.send(answer))
        answering.start()
        done = run_command("status", str(free_port))
        answering.join()
    said = done.stderr if status == 2 else done.stdout
    assert done.returncode == status and words in said
    assert len(said.splitlines()) == 1
