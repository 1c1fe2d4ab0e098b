# SPDX-License-Identifier: GPL-3.0-or-later
"""Readings and health as ROS 2 messages: plain fields, for whatever encodes or publishes them.

The definitions of the common messages are those of the packages ``builtin_interfaces``,
``std_msgs``, ``geometry_msgs`` and ``diagnostic_msgs``, which have not changed since ROS 2 Foxy.
"""

import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timedelta, timezone
from functools import cache
from typing import Any

from ..errors import InputError
from .readings import Flag, flag_bits, parsed_utc

READING = "wiforce_msgs/msg/PressReading"
WRENCH = "geometry_msgs/msg/WrenchStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

_FLAGS = "".join(f"uint32 FLAG_{flag.name}={flag.value}\n" for flag in Flag)
PRESS_READING = f"""\
# Force and location on one sensor in one phase group, as measured by gr-wiforce.
# Unknown numbers are NaN.

int8 TOUCH_UNKNOWN=-1
int8 UNTOUCHED=0
int8 TOUCHED=1

# Conditions that qualify a reading; docs/sensors.md explains them.
{_FLAGS}
# stamp: UTC at the centre of the group, zero when unknown. frame_id: the sensor's frame.
std_msgs/Header header
# Identifier of the run, empty for a recording.
string run
string sensor
# Index of the phase group in the run, -1 when unknown.
int64 group
# Centre of the group: seconds from the first sample, and device time.
float64 time_s
float64 device_time_s
int8 touch
# Force, and distance of its location from port 1, with standard deviations.
float64 force_n
float64 force_std_n
float64 location_mm
float64 location_std_mm
# Of a surface: position across its strips, with standard deviation; location_mm is x.
float64 y_mm
float64 y_std_mm
# Phases of the reflections at both ports.
float64 phase1_deg
float64 phase2_deg
float64 snr_db
# Share of the group that was left out because another transmitter interfered with it.
float64 interference
# Empty when nothing is wrong. The sum of the constants above, and their names in lower case.
uint32 flag_bits
string[] flags
"""

# By package and name.
_DEFINITIONS = {
    "wiforce_msgs/PressReading": PRESS_READING,
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z\n",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque\n",
    "geometry_msgs/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench\n",
    "diagnostic_msgs/KeyValue": "string key\nstring value\n",
    "diagnostic_msgs/DiagnosticStatus": """\
byte OK=0
byte WARN=1
byte ERROR=2
byte STALE=3
byte level
string name
string message
string hardware_id
diagnostic_msgs/KeyValue[] values
""",
    "diagnostic_msgs/DiagnosticArray": """\
std_msgs/Header header
diagnostic_msgs/DiagnosticStatus[] status
""",
}
_FIELD = re.compile(r"^([\w/]+)(\[\])? (\w+)$", re.MULTILINE)
_SEPARATOR = "=" * 80 + "\n"


@cache
def fields_of(type_name: str) -> dict[str, tuple[str, bool]]:
    """Type of each field of a message ``PACKAGE/NAME`` by its name, and whether it is an array."""
    text = _DEFINITIONS[type_name.replace("/msg/", "/")]
    return {name: (kind, bool(array)) for kind, array, name in _FIELD.findall(text)}


NUMBERS_OF_READING = [name for name, (kind, _) in fields_of(READING).items() if kind == "float64"]


def complete_definition(type_name: str) -> str:
    """The definition of a message followed by those of all that it contains (``ros2msg``)."""
    root = type_name.replace("/msg/", "/")
    contained, pending = [root], [root]
    while pending:
        for kind, _ in fields_of(pending.pop()).values():
            if kind in _DEFINITIONS and kind not in contained:
                contained.append(kind)
                pending.append(kind)
    texts = [f"{_SEPARATOR}MSG: {name}\n{_DEFINITIONS[name]}" for name in contained[1:]]
    return "".join([_DEFINITIONS[root], *texts])


_EPOCH = datetime(1970, 1, 1, tzinfo=timezone.utc)
_OK, _WARN, _ERROR = 0, 1, 2
_LEVELS = {"reading": _OK, "ending": _OK, "lost": _ERROR}
_TOUCH_UNKNOWN = -1
_HEALTH_TOPIC = "/diagnostics"  # where ROS tools expect it
_CLEAR, _FLAGGED = "wrench", "wrench_doubtful"


@dataclass(frozen=True)
class RosMessage:
    """One message ``PACKAGE/msg/NAME``, fields by name; ``stamp_ns`` is UTC since 1970 or None."""

    topic: str
    type: str
    fields: dict[str, Any]
    stamp_ns: int | None = None


def topic_of(sensor: str, name: str) -> str:
    """Topic of a sensor: characters that ROS does not permit in names become underscores."""
    token = re.sub("[^A-Za-z0-9_]", "_", sensor)
    # ROS permits neither digits at the start of a part of a name nor repeated underscores.
    token = re.sub("__+", "_", f"_{token}" if token[:1].isdigit() else token)
    return f"/wiforce/{token}/{name}"


def topics_of(sensors: Iterable[str]) -> dict[str, str]:
    """All topics of a run, with message types; refuses two sensors with the same topics."""
    topics = {_HEALTH_TOPIC: DIAGNOSTICS}
    named: dict[str, str] = {}
    for sensor in sensors:
        topic = topic_of(sensor, "reading")
        if (other := named.setdefault(topic, sensor)) != sensor:
            rule = f"has the same ROS topic as {other!r}, {topic}; rename one of them"
            raise InputError(f"sensor {sensor!r}", rule)
        topics[topic] = READING
        topics |= {topic_of(sensor, name): WRENCH for name in (_CLEAR, _FLAGGED)}
    return topics


def ros_messages(message: Mapping[str, Any]) -> Iterator[RosMessage]:
    """What a message of ``gr-wiforce live --zmq`` becomes; its key ``message`` is its kind."""
    if message["message"] == "reading":
        yield from reading_messages(message)
    else:
        yield health_message(message)


def reading_messages(row: Mapping[str, Any]) -> Iterator[RosMessage]:
    """One reading, a row of a file, and its wrench about the origin of the sensor's frame.

    At port 1, x along the line, z out of the surface: (0, 0, -F) with torque (0, F l/1000, 0), on
    surfaces (-F y/1000, F x/1000, 0). Readings that are doubtful have a topic of their own.
    """
    sensor, words = str(row["sensor"]), tuple((row.get("flags") or "").split())
    stamp_ns = _nanoseconds(row.get("time_utc"))
    header = _header(stamp_ns, sensor)
    touch, group = row.get("touch"), row.get("group")
    numbers = {name: row.get(name) for name in NUMBERS_OF_READING}
    fields: dict[str, Any] = {
        **{name: math.nan if n is None else float(n) for name, n in numbers.items()},
        "header": header,
        "run": row.get("run") or "",
        "sensor": sensor,
        "group": -1 if group is None else int(group),
        "touch": _TOUCH_UNKNOWN if touch is None else int(touch),
        "flag_bits": flag_bits(words),
        "flags": list(words),
    }
    yield RosMessage(topic_of(sensor, "reading"), READING, fields, stamp_ns)
    untouched = touch == 0
    force_n = 0.0 if untouched else fields["force_n"]
    torque_nm = 0.0 if untouched else force_n * fields["location_mm"] / 1000
    # A line has no y, also where its row is in a table with the columns of a surface.
    along_line = untouched or row.get("y_mm") is None
    across_nm = 0.0 if along_line else 0.0 - force_n * row["y_mm"] / 1000
    wrench = {"force": _vector(z=0.0 - force_n), "torque": _vector(across_nm, torque_nm)}
    flagged = bool(words) or not math.isfinite(torque_nm + across_nm)
    topic = topic_of(sensor, _FLAGGED if flagged else _CLEAR)
    yield RosMessage(topic, WRENCH, {"header": header, "wrench": wrench}, stamp_ns)


def health_message(report: Mapping[str, Any]) -> RosMessage:
    """Health of a run, by a heartbeat or its end: the reader's status and each sensor's."""
    stamp_ns = _nanoseconds(report.get("time_utc"))
    run, state, reason = (str(report.get(key, "")) for key in ("run", "state", "reason"))
    level = _LEVELS.get(state, _WARN)
    if state == "ended":
        level = _ERROR if report.get("exit_status") else _OK
    elif level == _OK and reason:
        level = _WARN  # a sensor is not received
    own = {key: value for key, value in report.items() if key not in ("message", "sensors")}
    text = f"{state}: {reason}" if reason else state
    status = [_status("reader", level, text, run, own)]
    for sensor, health in report.get("sensors", {}).items():
        level, text = _sensor_state(health)
        status.append(_status(sensor, level, text, run, health))
    fields = {"header": _header(stamp_ns, ""), "status": status}
    return RosMessage(_HEALTH_TOPIC, DIAGNOSTICS, fields, stamp_ns)


def built(
    type_name: str,
    fields: Mapping[str, Any],
    class_of: Callable[[str], type],
    byte: Callable[[int], Any] = int,
) -> Any:
    """A message of a library's classes, by ``class_of`` ``PACKAGE/NAME`` and its ``byte``."""
    values = {}
    for name, (kind, array) in fields_of(type_name).items():
        value = fields[name]
        if "/" in kind and array:
            value = [built(kind, each, class_of, byte) for each in value]
        elif "/" in kind:
            value = built(kind, value, class_of, byte)
        elif kind == "byte":
            value = byte(value)
        values[name] = value
    return class_of(type_name.replace("/msg/", "/"))(**values)


def _sensor_state(health: Mapping[str, Any]) -> tuple[int, str]:
    if not health["received"]:
        return _ERROR, "not received"
    problem = health["reference_problem"]
    return (_WARN, problem) if problem else (_OK, "received")


def _status(
    name: str, level: int, text: str, run: str, values: Mapping[str, Any]
) -> dict[str, Any]:
    pairs = [{"key": key, "value": value} for key, value in _pairs(values)]
    return {
        "level": level,
        "name": f"gr-wiforce: {name}",
        "message": text,
        "hardware_id": run,
        "values": pairs,
    }


def _pairs(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _pairs(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", "" if value is None else str(value)


def _header(stamp_ns: int | None, frame: str) -> dict[str, Any]:
    seconds, nanoseconds = divmod(stamp_ns or 0, 10**9)
    return {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": frame}


def _nanoseconds(time_utc: str | None) -> int | None:
    if not time_utc:
        return None
    return (parsed_utc(time_utc) - _EPOCH) // timedelta(microseconds=1) * 1000


def _vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> dict[str, float]:
    return {"x": x, "y": y, "z": z}
