# SPDX-License-Identifier: GPL-3.0-or-later
"""What happened to the samples of a stream, in words for warnings and summaries."""


def describe_loss(gaps: int, samples_lost: int) -> str:
    """The loss of samples that gaps account for."""
    return f"{_count(gaps, 'gap')}, {_count(samples_lost, 'sample')} lost"


def describe_events(frames_moved: int, times_ignored: int = 0) -> list[str]:
    """Events that make times uncertain, although no loss of samples was counted.

    Returns list of str: one phrase for each kind of event that occurred.

    ``frames_moved``: times that the frame timing shifted without an ``rx_time`` tag;
    ``times_ignored``: implausible ``rx_time`` tags.
    """
    phrases = []
    if frames_moved:
        times = "once" if frames_moved == 1 else f"{frames_moved} times"
        phrases.append(
            f"frame timing shifted {times}; times may be off by a multiple of the frame length"
        )
    if times_ignored:
        phrases.append(f"ignored {_count(times_ignored, 'implausible rx_time tag')}")
    return phrases


def _count(number, noun):
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
