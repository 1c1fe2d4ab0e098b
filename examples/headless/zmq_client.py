#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Print the touches without a doubt that `gr-wiforce live --zmq 5555` publishes.

With `--zmq-keys`, the client needs keys: NAME.key_secret, with server.key beside it.
"""

import json
import signal
import sys
from pathlib import Path

import zmq
from zmq.auth import load_certificate

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:5555"
if len(sys.argv) > 3 or "://" not in endpoint:
    usage = "usage: zmq_client.py [ENDPOINT [NAME.key_secret]]"
    print(f"{usage}, for example: zmq_client.py tcp://127.0.0.1:5555", file=sys.stderr)
    sys.exit(2)
subscriber = zmq.Context().socket(zmq.SUB)
if len(sys.argv) == 3:
    secret = Path(sys.argv[2])
    subscriber.curve_publickey, subscriber.curve_secretkey = load_certificate(secret)
    subscriber.curve_serverkey, _ = load_certificate(secret.with_name("server.key"))
subscriber.connect(endpoint)
subscriber.subscribe('{"message": "reading"')
# Ends without a traceback at Ctrl-C, and when `| head` closes the pipe.
for number in (signal.SIGINT, signal.SIGPIPE):
    signal.signal(number, signal.SIG_DFL)
while True:
    reading = json.loads(subscriber.recv_string())
    if reading["touch"] and not reading["flags"]:
        print(
            reading["sensor"], reading["force_n"], "N at", reading["location_mm"], "mm", flush=True
        )
