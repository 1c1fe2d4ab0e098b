# SPDX-License-Identifier: GPL-3.0-or-later
"""What happened to a stream besides losses that can be counted, in words."""


def mishaps(frames_moved, times_ignored=0):
    """Phrases for messages; empty when there is nothing to say."""
    said = []
    if frames_moved:
        count = _times(frames_moved)
        said.append(f"frames came elsewhere {count}: times may be off by whole frames")
    if times_ignored:
        said.append(f"the device told a time that cannot be {_times(times_ignored)}")
    return said


def _times(count):
    return "once" if count == 1 else f"{count} times"
