# SPDX-License-Identifier: GPL-3.0-or-later
"""Definitions of the ROS 2 messages that readings and health are stored and sent as.

The common ones are those of the packages ``builtin_interfaces``, ``std_msgs``, ``geometry_msgs``
and ``diagnostic_msgs``, whose definitions have not changed since ROS 2 Foxy.
"""

import re

READING = "wiforce_msgs/msg/PressReading"
WRENCH = "geometry_msgs/msg/WrenchStamped"
DIAGNOSTICS = "diagnostic_msgs/msg/DiagnosticArray"

PRESS_READING = """\
# Force and location on one sensor in one phase group, as measured by gr-wiforce.
# Unknown numbers are NaN.

int8 TOUCH_UNKNOWN=-1
int8 UNTOUCHED=0
int8 TOUCHED=1

# Conditions that qualify a reading; docs/sensors.md explains them.
uint32 FLAG_REFERENCE=1
uint32 FLAG_GAP=2
uint32 FLAG_TRANSITION=4
uint32 FLAG_WEAK=8
uint32 FLAG_AMBIGUOUS=16
uint32 FLAG_FORCE_UNOBSERVABLE=32
uint32 FLAG_INCONSISTENT=64
uint32 FLAG_EXTRAPOLATED=128
uint32 FLAG_MOVED=256
uint32 FLAG_SATURATED=512

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

_HEADER = """\
builtin_interfaces/Time stamp
string frame_id
"""

# By package and name.
_DEFINITIONS = {
    "wiforce_msgs/PressReading": PRESS_READING,
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec\n",
    "std_msgs/Header": _HEADER,
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


def fields_of(type_name: str) -> dict[str, tuple[str, bool]]:
    """Fields of a message.

    Returns dict: type of each field by its name, and whether it is an array.

    Parameters
    ----------
    type_name : str
        ``PACKAGE/NAME`` or ``PACKAGE/msg/NAME``.
    """
    text = _DEFINITIONS[type_name.replace("/msg/", "/")]
    return {name: (kind, bool(array)) for kind, array, name in _FIELD.findall(text)}


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
