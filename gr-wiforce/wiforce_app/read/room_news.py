# SPDX-License-Identifier: GPL-3.0-or-later
"""What is said of a room and of a stream while it is read."""

from ..shell.log import log


class RoomNews:
    """What each survey of a run has found that the one before had not."""

    def __init__(self):
        self._latest, self._known = None, []

    def report(self, found):
        """Print the findings that matter, where they differ from those printed before."""
        if found is None or found is self._latest:
            return
        self._latest = found
        mattering = [finding for finding in found if finding.matters]
        # Frequencies and levels differ a little from survey to survey.
        known = [(each.kind, round(each.frequency_hz), each.handling) for each in mattering]
        if known == self._known:
            return
        self._known = known
        lines = [finding.line for finding in mattering]
        for text in lines or ["nothing found any more that matters"]:
            log.info(f"room: {text}")


def describe_loss(gaps: int, samples_lost: int) -> str:
    """The loss of samples that gaps account for."""
    return f"{_count(gaps, 'gap')}, {_count(samples_lost, 'sample')} lost"


def describe_events(frames_moved: int, times_ignored: int = 0) -> list[str]:
    """A phrase for each kind of event that makes times uncertain without a loss of samples."""
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
