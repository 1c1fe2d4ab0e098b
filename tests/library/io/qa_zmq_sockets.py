# SPDX-License-Identifier: GPL-3.0-or-later
"""ZMQ sockets: the reader goes on whatever peers send, and with CURVE keys knows its peers."""

import json
import socket
import stat
import threading
import time
from concurrent.futures import Future
from contextlib import ExitStack

import pytest
import zmq
from command_runs import run_command
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.zmq_sockets import (
    ClientKeys,
    ReadingsPublisher,
    Replies,
    ServerKeys,
    answer_words,
    create_keys,
    endpoint_of,
    is_loopback,
    request,
)
from gnuradio.wiforce.io.readings import Reading
from live_runs import connected, served
from machine import free_port, wait_until

WAIT_S = 60.0
# Of a client that must get nothing; what is let in gets an answer in a few milliseconds.
NOTHING_S = 0.5


@pytest.fixture
def folders(tmp_path):
    """Keys of a reader with one client, and of another reader with another client."""
    for name in ("own", "other"):
        create_keys(tmp_path / name, client="robot")
    return tmp_path / "own", tmp_path / "other"


def strange_keys(own, other):
    """Keys of a client that the reader does not know, which knows the reader's own."""
    stranger = ClientKeys.load(other)
    return ClientKeys(stranger.public, stranger.secret, ServerKeys.load(own).public)


def test_create_keys_writes_private_files_and_overwrites_none(tmp_path):
    """A secret key that others can read protects nothing, and one that is replaced is lost."""
    folder = tmp_path / "keys"
    made = create_keys(folder)
    names = ["server.key", "server.key_secret", "clients/client.key", "client.key_secret"]
    assert [path.relative_to(folder).as_posix() for path in made] == names
    assert {stat.S_IMODE(path.stat().st_mode) for path in made} == {0o600}
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    before = {path: path.read_bytes() for path in made}
    with pytest.raises(InputError, match="client.key: exists already, and is not overwritten"):
        create_keys(folder)
    assert [path.name for path in create_keys(folder, "robot")] == ["robot.key", "robot.key_secret"]
    assert {path: path.read_bytes() for path in made} == before
    assert sorted(path.name for path in folder.iterdir()) == [
        "client.key_secret", "clients", "robot.key_secret", "server.key", "server.key_secret",
    ]  # fmt: skip


@pytest.mark.parametrize("name", ["", "server", "../x", "x" * 65])
def test_create_keys_other_names_are_refused(tmp_path, name):
    with pytest.raises(InputError, match="--client: must be letters"):
        create_keys(tmp_path / "keys", name)
    assert not (tmp_path / "keys").exists()


def test_keys_that_cannot_be_used_are_refused(folders, tmp_path):
    own, _ = folders
    with pytest.raises(InputError, match="nowhere/server.key_secret: does not exist"):
        ServerKeys.load(tmp_path / "nowhere")
    create_keys(own, "second")
    with pytest.raises(InputError, match="must hold one client's NAME.key_secret"):
        ClientKeys.load(own)
    assert ClientKeys.load(own / "second.key_secret").server == ServerKeys.load(own).public
    (own / "server.key_secret").chmod(0o604)
    with pytest.raises(InputError, match="must not be accessible to others"):
        ServerKeys.load(own)
    (own / "server.key_secret").chmod(0o640)  # a group is the administrator's choice
    ServerKeys.load(own)
    for name in ("robot", "second"):
        (own / "clients" / f"{name}.key").write_text("nothing")
    with pytest.raises(InputError, match="must hold the public key of a client"):
        ServerKeys.load(own)
    (own / "server.key_secret").write_text("nothing")
    with pytest.raises(InputError, match="must be a ZMQ certificate"):
        ServerKeys.load(own)
    (own / "server.key_secret").write_bytes((own / "server.key").read_bytes())
    (own / "server.key_secret").chmod(0o600)
    with pytest.raises(InputError, match="must hold a secret key"):
        ServerKeys.load(own)


def test_request_needs_keys_on_both_sides_or_none(folders):
    """Whoever is not known can neither tare nor stop a robot's reader, and sees why."""
    own, other = folders
    with served(keys=ServerKeys.load(own)) as (port, asked):
        assert request(str(port), "tare", WAIT_S, keys=ClientKeys.load(own)) == "TARE"
        for keys in (strange_keys(own, other), None, ClientKeys.load(other)):
            with pytest.raises(InputError, match="--zmq-keys: must be those of a client"):
                request(str(port), "stop", WAIT_S, keys=keys)
        assert asked == ["tare"]
    # The key proves that the server is the right one; without it, anybody could answer.
    with served() as (port, asked):
        with pytest.raises(InputError, match="--zmq-keys: must be .* or none where the server"):
            request(str(port), "status", WAIT_S, keys=ClientKeys.load(own))
        assert not asked


@pytest.mark.timeout(60)
def test_request_refused_before_it_is_sent_ends_at_once(folders, monkeypatch):
    """On a busy machine the reader refuses a client before the client sends."""
    own, _ = folders
    send = zmq.Socket.send_string

    def send_late(client, *words):
        wait_until(lambda: not client.poll(0, zmq.POLLOUT))
        send(client, *words)

    monkeypatch.setattr(zmq.Socket, "send_string", send_late)
    with served() as (port, _), pytest.raises(InputError, match="--zmq-keys: must be .* or none"):
        request(str(port), "status", WAIT_S, keys=ClientKeys.load(own))


def test_client_keys_can_be_added_and_removed_while_the_server_runs(folders):
    """A laptop that was stolen must be locked out without a restart."""
    own, _ = folders
    with served(keys=ServerKeys.load(own)) as (port, _):
        create_keys(own, "laptop")
        laptop = ClientKeys.load(own / "laptop.key_secret")
        assert request(str(port), "status", WAIT_S, keys=laptop) == "STATUS"
        (own / "clients" / "laptop.key").unlink()
        with pytest.raises(InputError, match="--zmq-keys: must be those"):
            request(str(port), "status", WAIT_S, keys=laptop)
        robot = ClientKeys.load(own / "robot.key_secret")
        assert request(str(port), "status", WAIT_S, keys=robot) == "STATUS"


def test_publisher_with_keys_sends_to_authorised_subscribers_only(folders):
    own, other = folders
    port = free_port()
    publisher = ReadingsPublisher(str(port), keys=ServerKeys.load(own))
    with ExitStack() as held:
        context = held.enter_context(zmq.Context())
        subscribers = {}
        for name, keys in (("known", ClientKeys.load(own)), ("strange", strange_keys(own, other))):
            subscribers[name] = held.enter_context(context.socket(zmq.SUB))
            keys.apply(subscribers[name])
            subscribers[name].connect(f"tcp://127.0.0.1:{port}")
            subscribers[name].subscribe("")
        stamp = {"run": "1"}
        known, reading = subscribers["known"], Reading(0.018, "arm")
        wait_until(lambda: known.poll(10), meanwhile=lambda: publisher.write(reading, stamp))
        assert json.loads(subscribers["known"].recv())["sensor"] == "arm"
        end = time.monotonic() + NOTHING_S
        while time.monotonic() < end:
            publisher.send("heartbeat", {})
            time.sleep(0.02)
        assert known.poll(0) and not subscribers["strange"].poll(0)
    publisher.close()


def test_sockets_that_are_closed_or_not_bound_leave_no_thread_behind(folders):
    own, _ = folders
    before = threading.active_count()
    replies = Replies(str(free_port()), str.upper, keys=ServerKeys.load(own))
    assert threading.active_count() > before
    replies.close()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        with pytest.raises(InputError, match="--control: cannot be bound"):
            Replies(str(taken.getsockname()[1]), str.upper, keys=ServerKeys.load(own))
    assert threading.active_count() == before


@pytest.mark.parametrize(
    "endpoint, expected",
    [
        ("tcp://127.0.0.1:5555", True),
        ("tcp://localhost:5555", True),
        ("tcp://[::1]:5555", True),
        ("tcp://0.0.0.0:5555", False),
        ("tcp://*:5555", False),
        ("tcp://localhost.example:5555", False),
    ],
)
def test_is_loopback_only_where_nobody_else_can_connect(endpoint, expected):
    assert is_loopback(endpoint) is expected
    # ZMQ binds to addresses only, and says 'No such device' for a name.
    assert endpoint_of("tcp://localhost:5555", "ENDPOINT") == "tcp://127.0.0.1:5555"


@pytest.fixture
def port():
    return free_port()


def test_what_is_no_request_costs_others_no_answer():
    answer = answer_words({"status": lambda: {"groups": 3}})
    with served(answer) as (port, _), zmq.Context() as context:

        def ask(*parts, wait_s=WAIT_S):
            with context.socket(zmq.REQ) as client:
                client.linger = 0
                client.connect(f"tcp://127.0.0.1:{port}")
                client.send_multipart(parts)
                return json.loads(client.recv()) if client.poll(1000 * wait_s) else None

        assert ask(b" status\n") == {"ok": True, "groups": 3}
        # A message without an envelope, as the first version of the protocol has it.
        with socket.create_connection(("127.0.0.1", port)) as stranger:
            stranger.sendall(b"\x01\x00" + b"\x06\x00hello")
            time.sleep(0.1)
        assert ask(b"\xff\xfe", b"", b"\x00")["ok"] is False
        assert ask(b"status" * 100_000, wait_s=0.1) is None  # too long
        assert ask(b"status")["ok"]


def test_answer_that_comes_later_is_sent_when_it_is_known(port):
    """A tare is answered when it is complete; others must not wait for it."""
    later = Future()
    replies = Replies(str(port), answer_words({"tare": lambda: later, "status": dict}))
    with connected(zmq.REQ, port) as first, connected(zmq.REQ, port) as last:
        first.send(b"tare")
        last.send(b"status")
        wait_until(lambda: last.poll(5), meanwhile=lambda: replies.serve(10))
        assert json.loads(last.recv()) == {"ok": True} and not first.poll(50)
        later.set_result("complete")
        replies.close()
        assert first.recv() == b"complete"


def test_request_without_a_reader_ends_in_time(port):
    begin = time.monotonic()
    assert request(str(port), "status", 0.1) is None
    assert time.monotonic() - begin < 30


@pytest.mark.parametrize("host", ["nowhere.invalid", "192.0.2.1"])
def test_endpoint_of_another_machine_is_refused_with_the_rule(port, host):
    with pytest.raises(
        InputError, match="cannot be bound .ADDRESS must be an IPv4 address of this"
    ):
        ReadingsPublisher(f"tcp://{host}:{port}")


@pytest.mark.parametrize(
    ("answer", "status", "words"),
    [
        ("READY", 2, "must be the --control endpoint of a reader of this version"),
        ('{"ok": true, "state": "reading", "sensors": {"arm": {}}}', 2, "it answers otherwise"),
        ('{"ok": false, "error": "100 requests wait"}', 1, "status refused: 100 requests wait"),
    ],
)
def test_status_of_what_is_no_reader_is_one_line(answer, status, words):
    """A port that was mixed up must not look like a fault of the program."""
    with served(lambda word: answer) as (port, _):
        done = run_command("status", str(port))
    said = done.stderr if status == 2 else done.stdout
    assert done.returncode == status and words in said
    assert len(said.splitlines()) == 1
