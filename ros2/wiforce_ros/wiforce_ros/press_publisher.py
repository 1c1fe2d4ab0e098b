# SPDX-License-Identifier: GPL-3.0-or-later
"""A node that publishes what ``gr-wiforce live --zmq`` sends."""

import importlib
import json

import rclpy
import zmq
from gnuradio.wiforce.io.network.zmq_sockets import ClientKeys
from gnuradio.wiforce.io.ros_messages import built, ros_messages
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node

DEPTH = 100  # messages that wait for a subscriber: 1.2 s of three topics
LOOK_S = 0.005
MOST_A_LOOK = 100  # so that parameters and shutdown are served meanwhile


def class_of(name):
    """The class of a message ``PACKAGE/NAME`` under ROS."""
    package, _, kind = name.partition("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def octet(value):
    """A ``byte`` as rclpy has it."""
    return bytes([value])


class PressPublisher(Node):
    """Publishes every message of the reader on the topic that MCAP files have it on.

    Parameters of the node: ``endpoint`` (``tcp://127.0.0.1:5555``) of the reader, and ``keys``, the
    secret key of a client where the reader encrypts.
    """

    def __init__(self):
        super().__init__("wiforce")
        endpoint = self.declare_parameter("endpoint", "tcp://127.0.0.1:5555").value
        keys = self.declare_parameter("keys", "").value
        self._topics = {}
        self._context = zmq.Context()
        self._subscriber = self._context.socket(zmq.SUB)
        if keys:
            ClientKeys.load(keys).apply(self._subscriber)
        self._subscriber.subscribe(b"")
        self.connect(endpoint)
        self.create_timer(LOOK_S, self.look)
        self.get_logger().info(f"publishing the readings of {endpoint}")

    def connect(self, endpoint):
        """Receive from a reader as well."""
        self._subscriber.connect(endpoint)

    def look(self):
        """Publish what has arrived."""
        for _ in range(MOST_A_LOOK):
            if not self._subscriber.poll(0):
                return
            self.take(self._subscriber.recv())

    def take(self, data):
        """Publish the messages that one message of the reader becomes."""
        try:
            messages = list(ros_messages(json.loads(data)))
        except (KeyError, TypeError, ValueError) as error:
            warning = f"ignored what is no message of gr-wiforce: {type(error).__name__} {error}"
            self.get_logger().warning(warning, throttle_duration_sec=10)
            return
        for message in messages:
            publisher = self._topics.get(message.topic)
            if publisher is None:
                kind = class_of(message.type.replace("/msg/", "/"))
                publisher = self.create_publisher(kind, message.topic, DEPTH)
                self._topics[message.topic] = publisher
            publisher.publish(built(message.type, message.fields, class_of, octet))

    def destroy_node(self):
        """Disconnect from the reader."""
        self._subscriber.close(linger=0)
        self._context.term()
        super().destroy_node()


def main():
    """Run the node until it is shut down."""
    rclpy.init()
    node = PressPublisher()
    try:
        rclpy.spin(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


if __name__ == "__main__":
    main()
