# SPDX-License-Identifier: GPL-3.0-or-later
"""A capture read with and without a survey of its room, and what every step of that costs."""

import time
from dataclasses import dataclass, replace

import numpy as np
from gnuradio.wiforce.estimation.capture.compression import Compression, image_operator
from gnuradio.wiforce.estimation.clocks.tracked_tag import TagClock
from gnuradio.wiforce.planning.room.report import (
    COMPRESSION,
    NOISE_WEIGHTS,
    UNLISTED_TAGS,
    changes_of,
    skipped_of,
)
from gnuradio.wiforce.receiver import Receiver
from gnuradio.wiforce.receiver.recording import RecordingReader
from gnuradio.wiforce.signal.room_noise import room_noise

# Clock of a tag that is not there, relative to the highest of the scene: none of its lines should
# meet theirs.
_CLOCK_RATIOS = (1.73, 1.31, 2.27)


@dataclass(frozen=True)
class RoomReading:
    """What reading a capture gave, and the processor time that it took.

    Attributes
    ----------
    readings : list of Reading
    plan : Plan
        By which it was read.
    start_s : float
        Until the first group: search of frames and, where wanted, the survey.
    samples_s, groups_s : float
        From samples to tones, and from tones to readings.
    """

    readings: list
    plan: object
    start_s: float
    samples_s: float
    groups_s: float


def read_room(recording, settings, survey):
    """Read a recording one step after the other.

    Parameters
    ----------
    settings : Plan
        Of its scene.
    survey : bool
        Whether to survey the room.
    """
    began = time.process_time()
    reader = RecordingReader(recording, settings, frame_offset=0, survey=survey)
    started = time.process_time()
    batches = [reader.source.read()]
    while len(batches[-1]):
        batches.append(reader.source.read())
    folded = time.process_time()
    receiver = Receiver(reader.plan)
    readings = [reading for batch in batches for reading in receiver.process(batch)]
    readings += receiver.finish(reader.groups)
    ended = time.process_time()
    return RoomReading(readings, reader.plan, started - began, folded - started, ended - folded)


def survey_of_room(recording, settings):
    """What the survey adds to a plan and skips, and the cost of both.

    Parameters
    ----------
    recording : Capture
        Of one antenna.
    settings : Plan
        Of its scene.

    Returns
    -------
    dict
        Plain values: ``added`` and ``skipped`` (texts); ``tones`` before and after; ``survey_s``
        per capture; ``plain_s`` and ``surveyed_s``, processor time of reading without and with what
        the survey adds; ``saved_s``, the time that each skipped step would add.
    surveyed, plain : RoomReading
        With and without it.
    """
    read_room(recording, settings, True)  # tables and imports of the first run
    plain, surveyed = (_quicker(recording, settings, survey) for survey in (False, True))
    saved = {
        name: max(_quicker(recording, forced, False).groups_s - plain.groups_s, 0.0)
        for name, forced in _forced(settings).items()
        if name in skipped_of(surveyed.plan)
    }
    row = {
        "added": changes_of(settings, surveyed.plan),
        "skipped": skipped_of(surveyed.plan),
        "tones": [len(each.table.tones) for each in (settings, surveyed.plan)],
        "survey_s": max(surveyed.start_s - plain.start_s, 0.0),
        "plain_s": plain.samples_s + plain.groups_s,
        "surveyed_s": surveyed.samples_s + surveyed.groups_s,
        "saved_s": saved,
    }
    return row, surveyed, plain


def _quicker(recording, settings, survey):
    """The quicker one of two runs."""
    runs = [read_room(recording, settings, survey) for _ in range(2)]
    return min(runs, key=lambda run: run.start_s + run.samples_s + run.groups_s)


def _forced(settings):
    """The plan with each step that only some rooms need."""
    forced = {}
    for ratio in _CLOCK_RATIOS:
        more = replace(settings, others=(TagClock(ratio * max(settings.clocks_hz)),))
        if more.separable:
            forced[UNLISTED_TAGS] = more
            break
    # One line, as strong as the noise of a snapshot, between the first two of the first tag.
    line_hz = np.array([1.5 * settings.clocks_hz[0]])
    noise = room_noise(
        line_hz, np.ones(1), settings.group_length, settings.waveform.snapshot_period_s
    )
    forced[NOISE_WEIGHTS] = replace(settings, room=noise)
    waveform = settings.waveform
    image = image_operator(np.zeros(waveform.symbol_length), 0.0, waveform)
    forced[COMPRESSION] = replace(settings, compression=Compression(image, 0.0))
    return forced
