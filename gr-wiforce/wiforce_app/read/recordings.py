# SPDX-License-Identifier: GPL-3.0-or-later
"""Recordings of every kind: opened and read, with what is said of them and of the room."""

from gnuradio.wiforce.estimation.capture.recorded_frames import ALL_FLAGGED, capture_problem
from gnuradio.wiforce.io.capture import open_capture
from gnuradio.wiforce.io.capture.channel_snapshots import ChannelSnapshots, open_snapshots
from gnuradio.wiforce.io.capture.names import is_snapshots
from gnuradio.wiforce.io.csi_tools import tool_of
from gnuradio.wiforce.planning.findings import findings, other_clocks, wrong_clocks
from gnuradio.wiforce.planning.plan import plan
from gnuradio.wiforce.press.sensor_state import describe_doubt
from gnuradio.wiforce.receiver.recording_reader import RecordingReader
from gnuradio.wiforce.scene import accepted_suspicions

from ..shell.log import log
from ..shell.options import refuse

# Why an option does not go with channel snapshots.
SAMPLES_ONLY = "is for captures of samples, not for channel snapshots"


def open_recording(path, datatype, csi=None):
    """A capture of samples, snapshots or a CSI tool, by its first bytes or stated arguments."""
    if datatype is None and csi is None and is_snapshots(path):
        return open_snapshots(path)
    if csi is not None or (datatype is None and tool_of(path) is not None):
        from gnuradio.wiforce.io.csi_tools import open_csi

        refuse({"--datatype": datatype}, SAMPLES_ONLY)
        return open_csi(path, **(csi or {}))
    return open_capture(path, datatype)


def open_reader(recording, settings, frame_offset, tracked):
    """The reader of a recording, after warnings of what was left out and of what is in the room."""
    of_samples = not isinstance(recording, ChannelSnapshots)
    if of_samples:
        reader = _reader_of(recording, settings, frame_offset, tracked)
    else:
        from gnuradio.wiforce.receiver.snapshot_reader import SnapshotReader

        reader = SnapshotReader(recording, settings, tracked)
    for note in reader.notes:
        warn(recording.path, note)
    if of_samples:
        warn_of_unequal_antennas(reader)
        RoomNews().report(findings(reader.survey, settings, reader.plan))
    return reader


def _reader_of(recording, *settings):
    """The reader of samples, with a warning where they end early."""
    reader = RecordingReader(recording, *settings)
    if recording.incomplete:
        warn(recording.path, recording.incomplete)
    return reader


def read_capture(recording, scene, frame_offset=0, tracked=False, on_groups=None):
    """All readings of a recording for another command, after warnings of what was wrong with it."""
    reader = _reader_of(recording, plan(scene), frame_offset, tracked, on_groups)
    warn_of_unequal_antennas(reader)
    readings = [reading for batch in reader for reading in batch]
    warn_of_events(reader)
    return readings


def warn_of_start(recording, reader, scene, differences, frame_offset):
    """Warn of differences between two scenes and of doubtful sensors; say where frames begin."""
    for text in (*differences, *accepted_suspicions(scene)):
        warn(recording.path, text)
    if frame_offset is None and getattr(reader, "frame_offset", 0):
        first = f"the first frame begins at sample {reader.frame_offset}"
        log.info(f"{recording.path}: {first}")


def warn_of_end(capture, reader):
    """Warn of what was wrong with a recording that has been read."""
    warn_of_events(reader)
    for name, found in reader.suspicions().items():
        for suspicion in found:
            warn(capture, f"{name}: {suspicion.text}")
    touched = reader.counts.touched_reference()
    receiver = getattr(reader, "receiver", None)  # a followed file's block has said the rest
    if receiver is None:
        return
    unread = reader.counts.groups and not reader.counts.clear
    if unread and isinstance(reader, RecordingReader):
        waveform = reader.plan.waveform
        if reader.notes:
            return
        if wrong := capture_problem(reader.recording, waveform, reader.frame_offset):
            log.warning(wrong)
            return
        causes = list(wrong_clocks(reader.survey, reader.plan).values())
        others_hz = [clock.clock_hz for clock in reader.plan.others]
        if not causes and others_hz and not any(s.seen for s in receiver.states.values()):
            causes = [other_clocks(others_hz)]
        for text in causes:
            warn(capture, text)
        if causes:
            return
    problems = {
        name: state.final_problem if unread else state.lasting_problem
        for name, state in receiver.states.items()
    }
    doubts = {name: describe_doubt(name, problem) for name, problem in problems.items() if problem}
    for text in (touched | doubts).values():
        warn(capture, text)
    if unread and not doubts:
        warn(capture, ALL_FLAGGED)


def warn(path, text):
    log.warning(f"{path}: {text}")


def warn_of_events(reader):
    """Warn of samples that a file lacked, and of frames that moved."""
    for path, missing in reader.samples_missing().items():
        if missing:
            warn(path, f"was truncated while it was read; {missing} samples are missing")
    for path, moved in reader.frames_moved().items():
        for event in describe_events(moved, reader.times_ignored):
            warn(path, event)


def warn_of_unequal_antennas(reader):
    """Warn of antennas that were recorded for different times."""
    antennas = sorted(reader.source.captures, key=lambda capture: capture.span)
    lacking = antennas[-1].span - antennas[0].span
    if lacking:
        seconds = lacking / reader.plan.waveform.sample_rate_hz
        rule = f"ends {lacking} samples ({seconds:.3g} s) before {antennas[-1].path}"
        warn(antennas[0].path, f"{rule}; groups that lack one antenna cannot be read")


class RoomNews:
    """What each survey of a run has found that the one before had not."""

    def __init__(self):
        self._known = []

    def report(self, found):
        """Print the findings that matter, where they differ from those printed before."""
        if found is None:
            return
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
