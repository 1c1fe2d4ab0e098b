# SPDX-License-Identifier: GPL-3.0-or-later
"""Block: folded frames of a capture, with its gaps, as its metadata and a scene describe it."""

from pathlib import Path
from typing import Any

from gnuradio import gr

from ...errors import InputError
from ...estimation.capture.folded_groups import frame_settings
from ...estimation.capture.recorded_frames import capture_problem
from ...io.capture.recordings import Capture, open_capture
from ...scene import Scene, load_scene
from ...wiforce_python import recording_source
from ..argument_types import typed


@typed
def capture_source(
    recording: str | Path | Capture,
    scene: str | Path | dict[str, Any] | Scene,
    frame_offset: int = 0,
    datatype: str | None = None,
) -> recording_source:
    """A ``recording_source`` for a capture of a scene.

    Output: one vector of a symbol's samples per frame, for a ``reader`` with the input ``folded``.
    Where the capture does not begin with frames at ``frame_offset``, a warning names the cause.

    Parameters
    ----------
    recording : str, Path or Capture
        SigMF pair, by either file's name or their common stem; raw samples with ``datatype``.
    scene : str, Path, dict or Scene
        Defines the sounding frame; must agree with the capture on sample rate and carrier.
    frame_offset : int
        Samples before the first frame.
    datatype : str, optional
        ``ci16_le`` or ``cf32_le``: the file is raw samples of this type.

    Returns
    -------
    recording_source

    Raises
    ------
    InputError
        Naming file, rule and value, when a file is missing, broken, or contradicts the scene.

    Examples
    --------
    >>> source = capture_source("press", "demo")  # doctest: +SKIP
    """
    if frame_offset < 0:
        raise InputError("frame_offset", "must be 0 or more", frame_offset)
    if not isinstance(recording, Capture):
        recording = open_capture(recording, datatype)
    scene = load_scene(scene)
    recording.check_against(scene)
    waveform = scene.waveform()
    shared = scene.environment.receive_antennas == 1 and scene.environment.reader_clock == "shared"
    if shared and (problem := capture_problem(recording, waveform, frame_offset)):
        gr.log.warn(f"capture_source: {problem}")
    return recording_source(**frame_settings(recording, waveform, frame_offset))
