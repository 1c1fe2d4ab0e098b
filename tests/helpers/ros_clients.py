# SPDX-License-Identifier: GPL-3.0-or-later
"""ROS 2 messages as others read them: rosbags decodes, websockets speaks with Foxglove servers."""

import json
import struct
import threading
import time
from collections import defaultdict

import websockets.sync.client
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

SUBPROTOCOL = "foxglove.sdk.v1"
MESSAGE_DATA = 1  # operation code of the protocol


def bag_messages(path):
    """Messages of an MCAP file by topic, decoded with the schemas stored in the file."""
    found = defaultdict(list)
    with AnyReader([path], default_typestore=get_typestore(Stores.EMPTY)) as reader:
        for connection, _, data in reader.messages():
            found[connection.topic].append(reader.deserialize(data, connection.msgtype))
    return found


class FoxgloveClient:
    """Subscribes to everything that a server advertises, until the server ends.

    ``messages``: decoded messages by topic.
    """

    def __init__(self, port):
        self.messages = defaultdict(list)
        self._url = f"ws://127.0.0.1:{port}"
        self._store, self._channels = get_typestore(Stores.EMPTY), {}
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def join(self):
        """Wait until the server has ended."""
        self._thread.join(30)
        assert not self._thread.is_alive()

    def _connect(self):
        deadline = time.monotonic() + 60
        while True:
            try:
                return websockets.sync.client.connect(self._url, subprotocols=[SUBPROTOCOL])
            except OSError:
                assert time.monotonic() < deadline, "no server"
                time.sleep(0.02)

    def _run(self):
        with self._connect() as connection:
            for data in connection:
                if isinstance(data, str):
                    self._subscribe(connection, json.loads(data))
                elif data[0] == MESSAGE_DATA:
                    (number, _) = struct.unpack_from("<IQ", data, 1)
                    topic, kind = self._channels[number]
                    message = self._store.deserialize_cdr(data[13:], kind)
                    self.messages[topic].append(message)

    def _subscribe(self, connection, said):
        if said["op"] != "advertise":
            return
        wanted = []
        for channel in said["channels"]:
            assert (channel["encoding"], channel["schemaEncoding"]) == ("cdr", "ros2msg")
            types = get_types_from_msg(channel["schema"], channel["schemaName"])
            known = self._store.fielddefs
            self._store.register({name: each for name, each in types.items() if name not in known})
            # Subscriptions may have any numbers; those of the channels are ready to hand.
            self._channels[channel["id"]] = channel["topic"], channel["schemaName"]
            wanted.append({"id": channel["id"], "channelId": channel["id"]})
        connection.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))
