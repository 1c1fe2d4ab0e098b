# SPDX-License-Identifier: GPL-3.0-or-later
"""The node of ros2/wiforce_ros, run with a stand-in for rclpy: ROS itself is not here."""

import importlib
import sys
import types
from collections import defaultdict
from pathlib import Path

import pytest
from gnuradio.wiforce.io.network.zmq_sockets import ReadingsPublisher
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.io.ros_messages import (
    DIAGNOSTICS,
    READING,
    WRENCH,
    complete_definition,
    fields_of,
)
from machine import free_port, wait_until
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROOT = Path(__file__).resolve().parents[2]
STAMP = {"run": "r", "time_utc": "2026-01-31T23:59:59.000000Z", "device_time_s": 1.0}


class StandInNode:
    """What the node uses of rclpy's."""

    def __init__(self, name):
        self.published, self.warnings, self.parameters = defaultdict(list), [], {}

    def declare_parameter(self, name, value):
        return types.SimpleNamespace(value=self.parameters.get(name, value))

    def create_timer(self, period_s, call):
        pass

    def get_logger(self):
        def warning(text, throttle_duration_sec):
            self.warnings.append(text)

        return types.SimpleNamespace(info=lambda text: None, warning=warning)

    def create_publisher(self, kind, topic, depth):
        def publish(message):
            assert isinstance(message, kind)
            self.published[topic].append(message)

        return types.SimpleNamespace(publish=publish)

    def destroy_node(self):
        pass


@pytest.fixture
def node(monkeypatch):
    """The node, with message classes of rosbags in the place of those of ROS."""
    store = get_typestore(Stores.ROS2_JAZZY)
    store.register(get_types_from_msg(complete_definition(READING), READING))
    modules = {name: types.ModuleType(name) for name in ("rclpy", "rclpy.executors", "rclpy.node")}
    modules["rclpy.node"].Node = StandInNode
    modules["rclpy.executors"].ExternalShutdownException = RuntimeError
    for name, kind in store.types.items():
        package, _, short = name.partition("/msg/")
        module = modules.setdefault(f"{package}.msg", types.ModuleType(f"{package}.msg"))
        setattr(module, short, kind)
    for name, module in modules.items():
        monkeypatch.setitem(sys.modules, name, module)
    monkeypatch.syspath_prepend(ROOT / "ros2/wiforce_ros")
    monkeypatch.delitem(sys.modules, "wiforce_ros.press_publisher", raising=False)
    made = importlib.import_module("wiforce_ros.press_publisher").PressPublisher()
    yield made
    made.destroy_node()


PYTHON_TYPES = {"string": str, "float64": float, "byte": bytes}


def check_types(message, name):
    """The types that rclpy demands of each field, down to the last."""
    for field, (kind, array) in fields_of(name).items():
        value = getattr(message, field)
        assert isinstance(value, list) == array, field
        for each in value if array else [value]:
            if "/" in kind:
                check_types(each, kind)
            else:
                assert type(each) is PYTHON_TYPES.get(kind, int), (field, each)


def test_node_publishes_what_the_reader_sends(node):
    """From the bytes on the wire to messages on the topics of MCAP files."""
    reading = Reading(0.018, "arm", 1, 4, 0.05, 45.0, 0.2, flags=("weak",))
    health = {"state": "lost", "reason": "", **STAMP}
    port = free_port()
    publisher = ReadingsPublisher(str(port))
    node.connect(f"tcp://127.0.0.1:{port}")

    def publish():  # again until the subscription has arrived
        publisher.write(reading, STAMP)
        publisher.send("heartbeat", health)
        node.look()

    wait_until(lambda: len(node.published) >= 3, 60, 0.01, meanwhile=publish)
    publisher.close()
    shown, *_ = node.published["/wiforce/arm/reading"]
    assert (shown.force_n, shown.flags, shown.flag_bits) == (4.0, ["weak"], 8)
    wrench, *_ = node.published["/wiforce/arm/wrench_doubtful"]
    assert (wrench.wrench.force.z, wrench.header.frame_id) == (-4.0, "arm")
    health, *_ = node.published["/diagnostics"]
    assert health.status[0].level == b"\2"  # as rclpy has a byte
    for message, name in ((shown, READING), (wrench, WRENCH), (health, DIAGNOSTICS)):
        check_types(message, name)


@pytest.mark.parametrize("data", [b"\xff", b"[]", b"{}", b'{"message": "reading"}', b"7"])
def test_node_ignores_what_is_no_message(node, data):
    node.take(data)
    assert len(node.warnings) == 1 and not node.published
