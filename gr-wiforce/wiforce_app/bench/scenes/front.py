# SPDX-License-Identifier: GPL-3.0-or-later
"""The Pareto front of a scene's settings, and settings that are better than the plan."""

# The plan is beaten by a setting that is faster and more accurate by this factor.
_MARGIN = 1.2


def front(points):
    """Points that no other point beats in both time and phase error, in order of time.

    Errors are converted to the group length of the plan, because a group of twice the length
    halves both the variance and the rate of readings.
    """
    best, kept = float("inf"), []
    readable = [point for point in points if point["phase_deg"] is not None]
    for point in sorted(readable, key=lambda point: point["cpu_s_per_s"]):
        if (found := rated_error(points, point)) < best:
            best = found
            kept.append(point)
    return kept


def rated_error(points, point):
    """Phase error of a point, converted to the plan's rate of readings."""
    return point["phase_deg"] * (point["group_length"] / points[0]["group_length"]) ** 0.5


def beat_the_plan(points, any_length=False):
    """Names of settings that are at least 20 % faster and 20 % more accurate than the plan.

    ``any_length`` includes groups of other lengths, which give fewer or more readings per second.
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
