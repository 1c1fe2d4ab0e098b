# SPDX-License-Identifier: GPL-3.0-or-later
"""Which settings of a scene no other beats, and which beat the plan's choice."""

# No setting is to be this much faster and more accurate at once than what the plan chose.
_MARGIN = 1.2


def front(points, error="phase_deg"):
    """Points that no other beats in both time and error, by rising time.

    Errors count as for the plan's group length: a group of twice the length halves the variance
    and the rate of readings alike.
    """
    best, kept = float("inf"), []
    readable = [point for point in points if point[error] is not None]
    for point in sorted(readable, key=lambda point: point["cpu_s_per_s"]):
        if (found := rated_error(points, point, error)) < best:
            best = found
            kept.append(point)
    return kept


def rated_error(points, point, error="phase_deg"):
    """Error of a point as it would be at the plan's rate of readings."""
    return point[error] * (point["group_length"] / points[0]["group_length"]) ** 0.5


def beat_the_plan(points, any_length=False):
    """Names of settings that are 20 % faster than the plan's choice and 20 % more accurate.

    ``any_length`` counts groups of other lengths, too: fewer or more readings a second.
    """
    chosen = points[0]
    if chosen["phase_deg"] is None:
        return []
    return [
        point["setting"]
        for point in points[1:]
        if point["phase_deg"] is not None
        and (any_length or point["group_length"] == chosen["group_length"])
        and point["cpu_s_per_s"] * _MARGIN < chosen["cpu_s_per_s"]
        and point["phase_deg"] * _MARGIN < chosen["phase_deg"]
    ]
