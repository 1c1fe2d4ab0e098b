# SPDX-License-Identifier: GPL-3.0-or-later
"""Pages of readings for tests: served in this process, with readings that the test publishes."""

import asyncio
import json
import socket
import threading
import time
from contextlib import ExitStack, closing, contextmanager
from urllib.parse import urlsplit

from gnuradio.wiforce.io.network.zmq_sockets import ReadingsPublisher, answer_words
from gnuradio.wiforce.io.readings import Reading
from live_runs import served
from machine import free_port, wait_until
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect
from wiforce_app.web.address import PageAddress

RUN = "20260101T000000Z-abcdef"


@contextmanager
def serving(source, token=None, **options):
    """A page in a thread: its address and its server."""
    from wiforce_app.web.server import PageServer  # Bokeh takes 1.5 s

    address = PageAddress("127.0.0.1", free_port(), token)
    made, ready = [], threading.Event()

    async def serve():
        server = PageServer(source, address, address.listen(), **options)
        made.extend((server, asyncio.get_running_loop()))
        ready.set()
        await server.serve()

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        assert ready.wait(100)
        yield f"http://127.0.0.1:{address.port}/", made[0]
    finally:
        made[1].call_soon_threadsafe(made[0].end)
        thread.join(20)


class Publisher:
    """A live reader of which a test says what it reads.

    ``refusal``: why it refuses a tare; empty where it does not. ``tare_s``: how long one takes.
    """

    def __init__(self, sensors=("arm",)):
        self.sensors, self.refusal, self.tare_s = sensors, "", 0.0
        self.tares = self.forced = 0
        self.readings, self._held = str(free_port()), ExitStack()
        self._publisher = self._held.enter_context(ReadingsPublisher(self.readings))
        answer = answer_words({"tare": self._tare, "tare force": self._force})
        port, _ = self._held.enter_context(served(answer))
        self.control = str(port)

    def _tare(self):
        self.tares += 1
        time.sleep(self.tare_s)
        return {"ok": False, "error": f"tare refused: {self.refusal}"} if self.refusal else {}

    def _force(self):
        self.forced += 1
        return {}

    def publish(self, *readings, run=RUN):
        for reading in readings:
            self._publisher.write(reading, {"run": run, "time_utc": None})

    def publish_rows(self, rows):
        """Publish rows of a frame of readings."""
        for row in rows:
            known = {key: None if value != value else value for key, value in row.items()}
            self._publisher.send("reading", {**known, "run": RUN})

    def heartbeat(self, state="reading", reason="", kind="heartbeat", run=RUN, **more):
        sensors = {
            name: {
                "age_s": 0.01,
                "received": True,
                "reference_problem": "",
                "clock_offset_ppm": 40.12 - 17.0 * number,
                "length_mm": 80.0,
            }
            for number, name in enumerate(self.sensors)
        }
        report = {"run": run, "scene": "hand", "time_s": 1.0, "state": state, "reason": reason}
        report |= {"tare": {"state": "none", "reason": ""}, "sensors": sensors, "gaps": 0}
        self._publisher.send(kind, {**report, "groups": {"dropped": 0}, **more})

    def until(self, condition, limit_s=60.0, **heartbeat):
        """Send heartbeats until a condition holds."""
        wait_until(condition, limit_s, meanwhile=lambda: self.heartbeat(**heartbeat))

    def close(self):
        self._held.close()


@contextmanager
def publishing(**options):
    with closing(Publisher(**options)) as publisher:
        yield publisher


def touched(time_s, force_n=3.0, location_mm=40.0, flags=(), stds=(0.05, 0.2)):
    """A reading of a touched sensor."""
    values = (1, force_n, stds[0], location_mm, stds[1], -20.0, 30.0, 12.34)
    return Reading(time_s, "arm", *values, flags, interference=0.25)


def untouched(time_s, sensor="arm"):
    return Reading(time_s, sensor, 0, snr_db=12.0, interference=0.0)


class RawViewer:
    """A browser's connection, which reads only when it is asked to; ``status`` of its request."""

    def __init__(self, url, path="/readings", origin=None, receive_buffer=None):
        address, self._held = urlsplit(url), ExitStack()
        own = self._held.enter_context(socket.socket())
        if receive_buffer is not None:
            own.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_buffer)
        own.connect((address.hostname, address.port))
        options = {"sock": own, "origin": origin, "compression": None, "close_timeout": 0.1}
        try:
            connection = connect(
                f"ws://{address.netloc}{path}", max_size=None, max_queue=1, **options
            )
            self._connection = self._held.enter_context(connection)
            self.status = 101
        except InvalidStatus as refusal:
            self.status = refusal.response.status_code

    def send(self, text):
        self._connection.send(text)

    def message(self):
        """The next message; None after the server has closed the connection."""
        try:
            return json.loads(self._connection.recv(timeout=60))
        except ConnectionClosed:
            return None

    def close(self):
        self._held.close()
