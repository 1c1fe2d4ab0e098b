# SPDX-License-Identifier: GPL-3.0-or-later
"""What is asked of captures by name: their readings, a plan for them, a survey of their room."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..estimation.groups import Groups
from ..estimation.room.survey import Survey
from ..io.capture.channel_snapshots import ChannelSnapshots, open_snapshots
from ..io.capture.names import find_captures, is_one, is_snapshots
from ..io.capture.recordings import Capture, open_capture
from ..io.readings import COLUMNS, NUMBERS, Flag
from ..planning.findings import (
    Finding,
    MeasuredTag,
    changes_of,
    findings,
    level_reference,
    measure_tags,
)
from ..planning.plan import Plan
from ..planning.plan import plan as plan_of
from ..scene import Scene, accepted_suspicions, load_scene, scene_of
from ..simulation.simulator import simulate as write_simulated
from .recording_reader import CaptureReader, RecordingReader
from .snapshot_reader import SnapshotReader

if TYPE_CHECKING:
    import pandas


def simulate(
    scene: str | Path | dict[str, Any] | Scene,
    name: str | Path,
    datatype: str = "ci16_le",
    progress: Callable[[int], object] | None = None,
    overwrite: bool = False,
) -> list[Path]:
    """Write the capture of a scene and its truth, for each receive antenna.

    The files ``NAME.sigmf-data``, ``NAME.sigmf-meta`` and ``NAME.truth.csv`` appear when all are
    complete; on failure nothing is left. Of a scene with packets, channel snapshots are written.

    Parameters
    ----------
    scene : str, Path, dict or Scene
        As for :func:`load_scene`.
    name : str or Path
        Path of the capture; ``.sigmf-data`` or ``.sigmf-meta`` at its end is left out.
    datatype : str
        ``ci16_le``: ADC codes, left-justified. ``cf32_le``: the same divided by 32768.
    progress : callable, optional
        Called with the number of samples written since the last call.
    overwrite : bool
        Replace existing files; otherwise they are refused.

    Returns
    -------
    list of Path
        Data, truth, metadata, antenna by antenna.

    Raises
    ------
    InputError
        For a mistake in the scene, one that could not be read (such as a clock whose lines alias
        onto one another), an unknown datatype, files that cannot be written, exist already or are
        those of the scene. Nothing has been simulated then.
    OutputError
        When the disk is full.

    Examples
    --------
    >>> scene = {
    ...     "sensors": [{"name": "arm", "model": "line-900mhz-calibrated"}],
    ...     "simulation": {"truth_model": "line-900mhz", "duration_s": 0.04},
    ... }
    >>> [path.name for path in simulate(scene, "short")]
    ['short.sigmf-data', 'short.truth.csv', 'short.sigmf-meta']
    """
    scene = load_scene(scene)
    plan_of(scene)
    return write_simulated(scene, name, datatype, progress, overwrite)


def read(
    capture: str | Path | Capture | ChannelSnapshots | list[str | Path] | tuple[str | Path, ...],
    scene: str | Path | dict[str, Any] | Scene | None = None,
    *,
    tracked: bool = False,
    datatype: str | None = None,
    frame_offset: int | None = None,
) -> pandas.DataFrame:
    """Read captures to force and location.

    Parameters
    ----------
    capture : str, Path, Capture, ChannelSnapshots, or list or tuple of str or Path
        SigMF pair, by either file's name or their common stem; raw samples with ``datatype``;
        channel snapshots as ``.npz``. A list, a folder or a pattern such as ``day*/press*``
        means several captures.
    scene : str, Path, dict or Scene, optional
        Scene file or the name of a shipped scene; the capture's own when not given. Keys in which
        it differs from the capture's own, if that holds one, are reported as warnings, as are
        mistakes that the presses (``Receiver.suspicions``) or the calibration suggest.
    tracked : bool
        Follow each press over time instead of inverting each group by itself.
    datatype : str, optional
        ``ci16_le`` or ``cf32_le``: the file is raw samples of this type.
    frame_offset : int, optional
        Samples before the first frame; searched in the samples when not given, and otherwise
        compared with them: a warning says where frames begin.

    Returns
    -------
    pandas.DataFrame
        A row per phase group and sensor with the columns of a readings file: ``time_s``,
        ``sensor``, ``touch``, ``force_n``, ``force_std_n``, ``location_mm``,
        ``location_std_mm``, ``phase1_deg``, ``phase2_deg``, ``snr_db``, ``flags`` (words
        with spaces between), ``group`` (index of the group), ``interference`` (share of the
        group that was left out because of it), ``ok`` (whether no flag but ``reference`` is
        set). A scene with a surface adds a row for it to each group, and the columns
        ``y_mm``, ``y_std_mm``, ``cov_force_x``, ``cov_force_y``, ``cov_x_y``. Of several
        captures, the first column, ``capture``, has their names. Numbers are not rounded;
        unknown values are NaN.

    Raises
    ------
    InputError
        (A ValueError) naming file or key, rule and value, when a file is missing, broken, or
        contradicts the scene, as when no frames are found or when they have another length.

    Notes
    -----
    Samples are mapped into memory. A handler of the signal SIGBUS, which is the whole process's,
    puts zeros where a file is cut off meanwhile. For other pages the program's own handler is
    called, but one that is set during a reading may be set aside again.

    Examples
    --------
    >>> import tempfile
    >>> from gnuradio import wiforce
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     files = wiforce.simulate(wiforce.load_scene("tabletop"), f"{folder}/press")
    ...     readings = wiforce.read(f"{folder}/press")
    >>> list(readings.columns[:4])
    ['time_s', 'sensor', 'touch', 'force_n']
    >>> good = readings[readings["ok"] & (readings["touch"] == 1)]
    >>> bool(len(good) > 50)
    True
    """
    import pandas

    settings = scene, tracked, datatype, frame_offset
    if isinstance(capture, list | tuple):
        if not capture:
            raise InputError("capture", "must name one capture or more")
        for each in capture:
            if not isinstance(each, str | Path):
                raise InputError("capture", "must be the path of a capture", each)
        given = [os.fspath(each) for each in capture]
    elif isinstance(capture, str | Path) and not is_one([os.fspath(capture)]):
        given = [os.fspath(capture)]
    else:
        return _read_one(capture, *settings)
    frames = []
    for named in find_captures(given, datatype):
        frame = _read_one(named.path, *settings)
        frame.insert(0, "capture", named.name)
        frames.append(frame)
    return pandas.concat(frames, ignore_index=True)


def _read_one(
    capture: str | Path | Capture | ChannelSnapshots,
    scene: str | Path | dict[str, Any] | Scene | None,
    tracked: bool,
    datatype: str | None,
    frame_offset: int | None,
) -> pandas.DataFrame:
    import pandas

    recording, reader, differences = _opened(capture, scene, tracked, datatype, frame_offset)
    scene_read = reader.plan.require_scene()
    incomplete = [recording.incomplete] if isinstance(recording, Capture) else []
    notes = [text for text in (*incomplete, *reader.notes) if text]
    for text in (*differences, *notes, *accepted_suspicions(scene_read)):
        warnings.warn(f"{recording.path}: {text}", stacklevel=3)
    also = scene_read.more_columns
    columns = (*COLUMNS, *also)
    rows = [
        [
            " ".join(reading.flags) if name == "flags" else getattr(reading, name, None)
            for name in columns
        ]
        for batch in reader
        for reading in batch
    ]
    for name, suspicions in reader.suspicions().items():
        for suspicion in suspicions:
            warnings.warn(f"{recording.path}: {name}: {suspicion.text}", stacklevel=3)
    for text in reader.counts.touched_reference().values():
        warnings.warn(f"{recording.path}: {text}", stacklevel=3)
    frame = pandas.DataFrame(rows, columns=list(columns))
    frame = frame.astype(dict.fromkeys(("touch", *NUMBERS, *also), float))
    # For `plot`, whose location axis shows whole sensors.
    frame.attrs["length_mm"] = max(each.model.length_mm for each in reader.plan.sensors)
    return frame.assign(ok=frame["flags"].isin(["", Flag.REFERENCE.word]))


def plan_for_capture(
    recording: str | Path | Capture,
    scene: str | Path | dict[str, Any] | Scene | None = None,
    datatype: str | None = None,
) -> Plan:
    """Plan of a scene, adapted to the room of a capture as by :func:`read`.

    Parameters
    ----------
    recording : str, Path or Capture
        SigMF pair, by either file's name or their common stem; raw samples with ``datatype``.
    scene : str, Path, dict or Scene, optional
        Scene file or the name of a shipped scene; the capture's own when not given.
    datatype : str, optional
        ``ci16_le`` or ``cf32_le``: the file is raw samples of this type.

    Returns
    -------
    Plan
        The scene's own where the room does not need another one.

    Raises
    ------
    InputError
        (A ValueError) as for :func:`read`.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> _ = wiforce.simulate("tabletop", "press")
    >>> len(wiforce.plan_for_capture("press").table.tones)
    16
    """
    return _opened(recording, scene, False, datatype, None)[1].plan


@dataclass(frozen=True, eq=False)
class RoomSurvey:
    """What a capture holds besides the tags of its scene, in its untouched reference.

    Attributes
    ----------
    survey : Survey
        The spectrum.
    planned, plan : Plan
        Of the scene, and adapted to the room.
    findings : list of Finding
    tags : list of MeasuredTag
        One per sensor.

    Examples
    --------
    >>> found = survey("press", "demo")  # doctest: +SKIP
    >>> print(found)  # doctest: +SKIP
    """

    survey: Survey
    planned: Plan
    plan: Plan
    findings: list[Finding]
    tags: list[MeasuredTag]

    def report(self) -> dict[str, Any]:
        """The survey as plain values.

        Returns
        -------
        dict
        """
        reference, name = level_reference(self.survey, self.planned)
        static = max(self.survey.static_power, 1e-30)
        changes, skipped = changes_of(self.planned, self.plan)
        return {
            "seconds": len(self.survey.spectrum) * 2 * self.survey.snapshot_period_s,
            "resolution_hz": self.survey.resolution_hz,
            "noise_floor_db": float(0.0 - 10 * np.log10(reference)),  # not -0.0
            "static_db": float(10 * np.log10(static / reference)),
            "level_reference": name,
            "findings": [finding.row() for finding in self.findings],
            "changes": changes,
            "skipped": skipped,
            "sensors": [asdict(tag) for tag in self.tags],
        }

    def __str__(self) -> str:
        report = self.report()
        found = [f"{finding.line} ({finding.meaning})" for finding in self.findings]
        return "\n".join(
            [
                f"{report['seconds']:.2f} s of untouched reference; levels in dB relative to "
                f"{report['level_reference']}",
                f"noise of a snapshot {report['noise_floor_db']:.1f} dB",
                f"static channel      {report['static_db']:.1f} dB",
                *(f"{tag.name + ' ':<20}{tag}" for tag in self.tags),
                "",
                *(found or ["found nothing besides the tags of the scene"]),
                "",
                *(f"needed: {change}" for change in report["changes"]),
                *(f"skipped: {skipped}" for skipped in report["skipped"]),
            ]
        )


def survey(
    capture: str | Path | Capture,
    scene: str | Path | dict[str, Any] | Scene | None = None,
    *,
    datatype: str | None = None,
) -> RoomSurvey:
    """Survey the room of a capture: movers, lamps, other tags, and what is done about them.

    Parameters
    ----------
    capture : str, Path or Capture
        As for :func:`read`; of samples.
    scene : str, Path, dict or Scene, optional
        Scene file or the name of a shipped scene; the capture's own when not given. Keys in which
        it differs from the capture's own are reported as warnings, as is a file that ends early.
    datatype : str, optional
        ``ci16_le`` or ``cf32_le``: the file is raw samples of this type.

    Returns
    -------
    RoomSurvey
        ``print`` shows it as ``gr-wiforce survey`` does.

    Raises
    ------
    InputError
        (A ValueError) as for :func:`read`, and where less than 0.1 s of the untouched reference is
        free of gaps.

    Examples
    --------
    >>> from gnuradio import wiforce
    >>> _ = wiforce.simulate("tabletop", "room")
    >>> wiforce.survey("room").tags[0].name
    'arm'
    """
    recording = capture if isinstance(capture, Capture) else open_capture(capture, datatype)
    return survey_room(
        recording,
        *scene_of(recording, scene),
        lambda text: warnings.warn(f"{recording.path}: {text}", stacklevel=4),
    )


def survey_room(
    recording: Capture, scene: Scene, differences: list[str], warn: Callable[[str], None]
) -> RoomSurvey:
    """Survey the room of an open capture (:func:`survey`), by what :func:`scene_of` gives."""
    for text in filter(None, (*differences, recording.incomplete)):
        warn(text)
    settings, batches = plan_of(scene), list[Groups]()
    reader = RecordingReader(recording, settings, on_groups=batches.append)
    if reader.survey is None:
        rule = "cannot be surveyed: needs 0.1 s of untouched reference without gaps"
        raise InputError(recording.path, rule)
    next(iter(reader))
    groups = batches[0] if batches else Groups(np.zeros(0, np.int64))
    return RoomSurvey(
        reader.survey,
        settings,
        reader.plan,
        findings(reader.survey, settings, reader.plan),
        measure_tags(settings, groups),
    )


def _opened(
    capture: str | Path | Capture | ChannelSnapshots,
    scene: str | Path | dict[str, Any] | Scene | None,
    tracked: bool,
    datatype: str | None,
    frame_offset: int | None,
) -> tuple[Capture | ChannelSnapshots, CaptureReader, list[str]]:
    """A capture of either kind, what reads it, and how its scene differs from its own."""
    if isinstance(capture, str | Path) and is_snapshots(capture):
        capture = open_snapshots(capture)
    if isinstance(capture, ChannelSnapshots):
        for name, value in (("datatype", datatype), ("frame_offset", frame_offset)):
            if value is not None:
                raise InputError(name, "must be None for channel snapshots", value)
        found, differences = scene_of(capture, scene)
        return capture, SnapshotReader(capture, plan_of(found), tracked), differences
    recording = capture if isinstance(capture, Capture) else open_capture(capture, datatype)
    found, differences = scene_of(recording, scene)
    reader = RecordingReader(recording, plan_of(found), frame_offset, tracked)
    return recording, reader, differences
