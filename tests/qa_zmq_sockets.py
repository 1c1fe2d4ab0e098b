# SPDX-License-Identifier: GPL-3.0-or-later
"""Requests over ZMQ: whatever a peer sends, the reader answers in JSON and goes on."""

import json
import socket

import numpy as np
import pytest
import zmq
from wiforce_app.zmq_sockets import Replies, answer_words


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
            replies.serve()
            if client.poll(5):
                answer = json.loads(client.recv())
                break
        client.close(linger=0)
        return answer

    yield send
    replies.close()


def test_a_word_that_is_known_is_answered(ask):
    assert ask(b"status") == {"ok": True, "groups": 3}
    assert ask(b" status\n") == {"ok": True, "groups": 3}


def test_two_hundred_broken_requests_do_not_end_the_reader(ask):
    rng = np.random.default_rng(7)
    for n in range(200):
        parts = [rng.bytes(rng.integers(0, 60)) for _ in range(1 + n % 4)]
        answer = ask(*parts)
        assert answer["ok"] is False and "must be one of status" in answer["error"]
    assert ask(b"status")["ok"]


def test_a_request_too_long_is_cut_off_and_the_next_one_answered(ask):
    assert ask(b"status" * 100_000) is None
    assert ask(b"status")["ok"]
