# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings and health as ROS 2 messages."""

import math
import re
from dataclasses import asdict
from pathlib import Path

import pytest
from gnuradio.wiforce.io.readings import Reading
from gnuradio.wiforce.io.ros_messages import (
    DIAGNOSTICS,
    PRESS_READING,
    WRENCH,
    complete_definition,
    health_message,
    reading_messages,
    topic_of,
)
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

ROOT = Path(__file__).resolve().parents[3]
PRESS = Reading(0.018, "arm", 1, 4.0, 0.05, 45.0, 0.2, 10.5, -20.25, 12.5, (), 7, 0.25)
STAMP = {"run": "r1", "time_utc": "2026-01-31T23:59:59.964001Z", "device_time_s": 1.5}
HEALTH = {
    "run": "r1",
    "time_utc": "2026-01-31T23:59:59.000000Z",
    "state": "reading",
    "reason": "",
    "tare": {"state": "none", "reason": ""},
    "sensors": {"arm": {"age_s": 0.04, "received": True, "reference_problem": ""}},
    "gaps": 3,
}


def wrench_of(reading):
    _, message = reading_messages(reading.row() | STAMP)
    force, torque = (message.fields["wrench"][key] for key in ("force", "torque"))
    assert (force["x"], force["y"], torque["x"], torque["z"]) == (0, 0, 0, 0)
    return message.topic.rpartition("/")[2], force["z"], torque["y"]


@pytest.mark.parametrize("name", [WRENCH, DIAGNOSTICS])
def test_common_definitions_have_the_type_hash_of_ros(name):
    """A subscriber under ROS would not match a definition that differs in a field."""
    own = get_typestore(Stores.EMPTY)
    own.register(get_types_from_msg(complete_definition(name), name))
    assert own.hash_rihs01(name) == get_typestore(Stores.ROS2_JAZZY).hash_rihs01(name)


def test_package_of_messages_holds_the_same_definition():
    """Bags written here and topics published under ROS would have different types."""
    packaged = (ROOT / "ros2/wiforce_msgs/msg/PressReading.msg").read_text(encoding="utf-8")
    assert packaged == PRESS_READING


def test_reading_message_holds_every_value_and_the_time():
    message, _ = reading_messages(PRESS.row() | STAMP)
    fields = message.fields
    assert message.stamp_ns == 1769903999_964001000
    assert fields["header"] == {
        "stamp": {"sec": 1769903999, "nanosec": 964001000},
        "frame_id": "arm",
    }
    row = PRESS.row() | {"run": "r1", "device_time_s": 1.5, "flags": []}
    assert {key: fields[key] for key in row} == row
    assert fields["flag_bits"] == 0 and math.isnan(fields["y_mm"])
    message, _ = reading_messages(PRESS.row() | {"y_mm": 12.5, "y_std_mm": 0.2})
    assert (message.fields["y_mm"], message.fields["y_std_mm"]) == (12.5, 0.2)


def test_reading_message_unknown_values_are_nan_and_flags_stay():
    row = Reading(0.018, "arm", flags=("gap", "weak")).row()
    message, wrench = reading_messages(row)
    fields = message.fields
    assert (fields["touch"], fields["group"], fields["run"]) == (-1, -1, "")
    assert fields["header"]["stamp"] == {"sec": 0, "nanosec": 0}
    assert math.isnan(fields["force_n"]) and math.isnan(fields["device_time_s"])
    assert (fields["flags"], fields["flag_bits"]) == (["gap", "weak"], 2 + 8)
    assert message.stamp_ns is None and wrench.topic == "/wiforce/arm/wrench_doubtful"


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, ("wrench", -4.0, 0.18)),  # torque is force times 45 mm
        ({"touch": 0, "force_n": None, "location_mm": None}, ("wrench", 0.0, 0.0)),
        ({"flags": ("weak",)}, ("wrench_doubtful", -4.0, 0.18)),
        ({"location_mm": None}, ("wrench_doubtful", -4.0, None)),
        ({"touch": None, "force_n": None}, ("wrench_doubtful", None, None)),
    ],
)
def test_wrench_flagged_readings_have_a_topic_of_their_own(changes, expected):
    """A controller that follows the clear topic must never act on a doubtful force."""
    name, *values = wrench_of(Reading(**asdict(PRESS) | changes))
    assert [name, *(None if math.isnan(value) else value for value in values)] == list(expected)
    # A force of -0 would be shown as such, and have the angle of a pull.
    assert all(math.copysign(1, value) == 1 for value in values if value == 0)


@pytest.mark.parametrize(
    ("changes", "levels"),
    [
        ({}, [0, 0]),
        ({"state": "lost", "reason": "no samples for 2.0 s"}, [2, 0]),
        ({"state": "reference"}, [1, 0]),
        ({"reason": "not received: arm"}, [1, 0]),
        ({"sensors": {"arm": {"age_s": 3.0, "received": False, "reference_problem": ""}}}, [0, 2]),
        (
            {"sensors": {"arm": {"age_s": 0.1, "received": True, "reference_problem": "forced"}}},
            [0, 1],
        ),
        ({"state": "ending"}, [0, 0]),
        ({"state": "ended", "reason": "signal", "exit_status": 0}, [0, 0]),
        ({"state": "ended", "reason": "disk full", "exit_status": 1}, [2, 0]),
    ],
)
def test_health_levels_by_state(changes, levels):
    status = health_message(HEALTH | changes).fields["status"]
    assert [each["level"] for each in status] == levels
    assert [each["name"] for each in status] == ["gr-wiforce: reader", "gr-wiforce: arm"]
    values = {pair["key"]: pair["value"] for each in status for pair in each["values"]}
    assert (values["gaps"], values["tare.state"]) == ("3", "none") and "age_s" in values


def test_topic_is_a_name_that_ros_accepts():
    for sensor in ("left arm", "2", "Daumen-ä", "a--b", "x/y"):
        assert re.fullmatch("(/[A-Za-z_][A-Za-z0-9_]*)+", topic_of(sensor, "reading"))
        assert "__" not in topic_of(sensor, "reading")
