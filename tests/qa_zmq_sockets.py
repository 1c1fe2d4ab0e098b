# SPDX-License-Identifier: GPL-3.0-or-later
"""Requests over ZMQ: whatever a peer sends, the reader answers in JSON and goes on."""

import json
import socket
import time

import pytest
import zmq
from gnuradio.wiforce.io.zmq_sockets import Replies, answer_words


@pytest.fixture
def ask():
    """Sends the parts of a request and gives the answer; None when there is none."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    replies = Replies(str(port), answer_words({"status": lambda: {"groups": 3}}))

    def send(*parts):
        client = zmq.Context.instance().socket(zmq.REQ)
        client.connect(f"tcp://127.0.0.1:{port}")
        client.send_multipart(list(parts))
        answer = None
        for _ in range(20 if sum(map(len, parts)) > 4096 else 400):
            replies.serve(10)
            if client.poll(5):
                answer = json.loads(client.recv())
                break
        client.close(linger=0)
        return answer

    send.port, send.serve = port, replies.serve
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
