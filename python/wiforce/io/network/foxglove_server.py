# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings and health as ROS 2 messages for Foxglove, by its WebSocket protocol."""

from collections.abc import Iterable, Mapping
from typing import Any

from ...errors import InputError
from ..optional import optional_modules
from ..outputs import Output
from ..ros_messages import (
    RosMessage,
    complete_definition,
    health_message,
    reading_messages,
    topics_of,
)
from . import listening_address

# Messages that wait for a client: some 4 s of one sensor. Of a slower client the oldest are
# dropped.
_BACKLOG = 256
_OPTION = "--foxglove"


class FoxgloveServer(Output):
    """Serves the messages of an MCAP file while they are made; never waits for a client.

    Clients learn of the sensors' topics when they connect, before there is a message.
    """

    def __init__(self, address: str, sensors: Iterable[str]) -> None:
        host, port = listening_address(address, _OPTION)
        # The writer of mcap_ros2 uses this module; it offers no other way to encode a message.
        modules = optional_modules(_OPTION, ["foxglove", "mcap_ros2._dynamic"])
        self._foxglove, self._encoding = modules
        # Below this, the SDK prints a line for whatever a client sends, which would fill a journal.
        self._foxglove.set_log_level("CRITICAL")
        self._context = self._foxglove.Context()
        self._encoders: dict[str, Any] = {}
        self._channels = {
            topic: self._channel_of(topic, kind) for topic, kind in topics_of(sensors).items()
        }
        try:
            self._server = self._foxglove.start_server(
                name="gr-wiforce",
                host=host,
                port=port,
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except RuntimeError as error:
            reason = str(error).removeprefix("FoxgloveError: ")
            raise InputError(_OPTION, f"cannot be bound ({reason})", address) from error

    def write_rows(self, rows: Iterable[Mapping[str, Any]]) -> None:
        for row in rows:
            for message in reading_messages(row):
                self._send(message)

    def send(self, kind: str, report: Mapping[str, Any]) -> None:
        self._send(health_message(report))

    def close(self) -> None:
        self._server.stop()

    def _send(self, message: RosMessage) -> None:
        channel = self._channels[message.topic]
        if channel.has_sinks():
            encoded = self._encoders[message.type](message.fields)
            channel.log(encoded, log_time=message.stamp_ns)

    def _channel_of(self, topic: str, name: str) -> Any:
        text = complete_definition(name)
        if name not in self._encoders:
            self._encoders[name] = self._encoding.serialize_dynamic(name, text)[name]
        schema = self._foxglove.Schema(name=name, encoding="ros2msg", data=text.encode())
        return self._foxglove.Channel(
            topic, schema=schema, message_encoding="cdr", context=self._context
        )
