# SPDX-License-Identifier: GPL-3.0-or-later
"""ZMQ sockets with CURVE keys: who may read and ask, and which errors others get."""

import json
import socket
import stat
import threading
import time
from contextlib import ExitStack, contextmanager

import pytest
import zmq
from gnuradio.wiforce.errors import InputError
from gnuradio.wiforce.io.network.zmq_keys import ClientKeys, ServerKeys, create_keys
from gnuradio.wiforce.io.network.zmq_sockets import ReadingsPublisher, Replies, is_loopback, request
from gnuradio.wiforce.io.readings import Reading

WAIT_S = 60.0
# Of a client that must get nothing; what is let in gets an answer in a few milliseconds.
NOTHING_S = 0.5


def free_port():
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@pytest.fixture
def folders(tmp_path):
    """Keys of a reader with one client, and of another reader with another client."""
    for name in ("own", "other"):
        create_keys(tmp_path / name, client="robot")
    return tmp_path / "own", tmp_path / "other"


@contextmanager
def served(keys):
    """The port of a server that answers in capitals, and the list of what it was asked."""
    asked, ended = [], threading.Event()

    def answer(text):
        asked.append(text)
        return text.upper()

    port = free_port()
    replies = Replies(str(port), answer, keys=keys)

    def serve():
        while not ended.wait(0.005):
            replies.serve(10)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield port, asked
    finally:
        ended.set()
        thread.join()
        replies.close()


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


@pytest.mark.parametrize("name", ["", "server", "../x", "a b", "x" * 65])
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
    (own / "server.key_secret").write_text("nothing")
    with pytest.raises(InputError, match="must be a ZMQ certificate"):
        ServerKeys.load(own)
    (own / "server.key_secret").write_bytes((own / "server.key").read_bytes())
    (own / "server.key_secret").chmod(0o600)
    with pytest.raises(InputError, match="must hold a secret key"):
        ServerKeys.load(own)


def test_server_keys_without_a_client_are_refused(folders):
    own, _ = folders
    (own / "clients" / "robot.key").unlink()
    (own / "clients" / "broken.key").write_text("nothing")
    with pytest.raises(InputError, match="must hold the public key of a client"):
        ServerKeys.load(own)


def test_request_authorised_client_is_answered(folders):
    own, _ = folders
    with served(ServerKeys.load(own)) as (port, _):
        assert request(str(port), "tare", WAIT_S, keys=ClientKeys.load(own)) == "TARE"


def test_request_not_authorised_is_refused_with_the_cause(folders):
    """Whoever is not known can neither tare nor stop a robot's reader, and sees why."""
    own, other = folders
    with served(ServerKeys.load(own)) as (port, asked):
        for keys, cause in (
            (strange_keys(own, other), "the server does not accept this client"),
            (None, "is missing: the server accepts clients with keys only"),
        ):
            with pytest.raises(InputError, match=f"--zmq-keys: {cause}"):
                request(str(port), "stop", WAIT_S, keys=keys)
        with pytest.raises(InputError, match="its server.key is another server's"):
            request(str(port), "stop", NOTHING_S, keys=ClientKeys.load(other))
        assert not asked


def test_request_with_keys_to_a_server_without_is_refused(folders):
    """The key proves that the server is the right one; without it, anybody could answer."""
    own, _ = folders
    with served(None) as (port, asked):
        with pytest.raises(InputError, match="--zmq-keys: the server has no keys"):
            request(str(port), "status", WAIT_S, keys=ClientKeys.load(own))
        assert not asked


def test_client_keys_can_be_added_and_removed_while_the_server_runs(folders):
    """A laptop that was stolen must be locked out without a restart."""
    own, _ = folders
    with served(ServerKeys.load(own)) as (port, _):
        create_keys(own, "laptop")
        laptop = ClientKeys.load(own / "laptop.key_secret")
        assert request(str(port), "status", WAIT_S, keys=laptop) == "STATUS"
        (own / "clients" / "laptop.key").unlink()
        with pytest.raises(InputError, match="does not accept this client"):
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
        for name, keys in (
            ("known", ClientKeys.load(own)),
            ("strange", strange_keys(own, other)),
            ("wrong server", ClientKeys.load(other)),
            ("none", None),
        ):
            subscribers[name] = held.enter_context(context.socket(zmq.SUB))
            if keys is not None:
                keys.apply(subscribers[name])
            subscribers[name].connect(f"tcp://127.0.0.1:{port}")
            subscribers[name].subscribe("")
        deadline = time.monotonic() + WAIT_S
        while not subscribers["known"].poll(10):
            assert time.monotonic() < deadline
            publisher.take(Reading(0.018, "arm"), {"run": "1"})
        assert json.loads(subscribers["known"].recv())["sensor"] == "arm"
        end = time.monotonic() + NOTHING_S
        while time.monotonic() < end:
            publisher.send("heartbeat", {})
            time.sleep(0.02)
        received = {name: bool(each.poll(0)) for name, each in subscribers.items()}
        assert received == {"known": True, "strange": False, "wrong server": False, "none": False}
    publisher.close()


def test_stopped_sockets_leave_no_thread_behind(folders):
    own, _ = folders
    before = threading.active_count()
    for _ in range(3):
        publisher = ReadingsPublisher(str(free_port()), keys=ServerKeys.load(own))
        replies = Replies(str(free_port()), str.upper, keys=ServerKeys.load(own))
        assert threading.active_count() > before
        publisher.close()
        replies.close()
    assert threading.active_count() == before


def test_endpoint_that_cannot_be_bound_leaves_no_thread_behind(folders):
    own, _ = folders
    before = threading.active_count()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        with pytest.raises(InputError, match="--control: cannot be bound"):
            Replies(str(taken.getsockname()[1]), str.upper, keys=ServerKeys.load(own))
    assert threading.active_count() == before


@pytest.mark.parametrize(
    "endpoint, expected",
    [
        ("tcp://127.0.0.1:5555", True),
        ("tcp://127.8.0.1:5555", True),
        ("tcp://localhost:5555", True),
        ("tcp://[::1]:5555", True),
        ("tcp://0.0.0.0:5555", False),
        ("tcp://*:5555", False),
        ("tcp://192.168.1.2:5555", False),
        ("tcp://eth0:5555", False),
        ("tcp://localhost.example:5555", False),
    ],
)
def test_is_loopback_only_where_nobody_else_can_connect(endpoint, expected):
    assert is_loopback(endpoint) is expected
