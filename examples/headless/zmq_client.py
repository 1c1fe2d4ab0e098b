#!/usr/bin/env python3
# SPDX-License-Identifier: GPL-3.0-or-later
"""Print the touches that `gr-wiforce live --zmq 5555` publishes."""

import json
import sys

import zmq

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:5555"
if len(sys.argv) > 2 or "://" not in endpoint:
    sys.exit("usage: zmq_client.py [ENDPOINT], for example: zmq_client.py tcp://127.0.0.1:5555")
subscriber = zmq.Context().socket(zmq.SUB)
subscriber.connect(endpoint)
subscriber.subscribe('{"message": "reading"')
while True:
    reading = json.loads(subscriber.recv_string())
    if reading["touch"]:
        print(
            reading["sensor"], reading["force_n"], "N at", reading["location_mm"], "mm", flush=True
        )
