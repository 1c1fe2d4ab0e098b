# SPDX-License-Identifier: GPL-3.0-or-later
"""Frame timing: the sample at which the frames of a stream begin."""

from __future__ import annotations

import numpy as np

from ...signal.waveform import Waveform
from ..groups import Array

# Samples from the frame's start to the strongest path: weaker paths may arrive up to 8 samples
# earlier, and echoes up to 56 samples later stay inside the repetition that is dropped.
MARGIN = 8
# Averaging this many frames raises the preamble by 33 dB over what changes from frame to frame.
SEARCHED_FRAMES = 2000
# Samples after which longer frames are no longer averaged: 92 MB, and 2000 frames of up to 2880.
_SEARCHED_SAMPLES = 5_760_000
_FEWEST_FRAMES = 16
# Ratio of the best match to the rms match of noise that counts as a preamble. The largest of 720
# matches of Gaussian noise exceeds 4.3 times their rms once in 10^5 searches.
_CLEAR = 12.0
# Shifts by more than a preamble and its echoes see noise only.
_ECHOES = 10
_LEAST_QUIET = 8


def whole_frames(samples: Array, frame_length: int) -> Array:
    """Cut samples into frames, without what remains after the last whole one.

    Returns ndarray, shape (n // frame_length, frame_length).

    Parameters
    ----------
    samples : ndarray, shape (n,)
        Any values, one per sample.
    """
    return samples[: len(samples) // frame_length * frame_length].reshape(-1, frame_length)


def searched_samples(waveform: Waveform) -> int:
    """Samples at the start of a stream in which frames are searched.

    Returns int: ``SEARCHED_FRAMES`` frames; fewer of long ones, whose preambles have as much
    energy.

    Parameters
    ----------
    waveform : Waveform
        As it was sent.
    """
    length = waveform.frame_length
    frames = min(SEARCHED_FRAMES, max(_FEWEST_FRAMES, _SEARCHED_SAMPLES // length))
    return frames * length


def find_frame_offset(samples: Array, waveform: Waveform) -> int | None:
    """Find the sample at which the first frame of a stream begins.

    Returns int or None: 0 <= offset < frame_length; ``MARGIN`` samples before the strongest path.
    None when no preamble is found.

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        At least one frame from the start of the stream; a thousand frames or more are better.
    waveform : Waveform
        As it was sent.

    Notes
    -----
    The mean frame, in which static paths add up, is correlated with the sent frame at every cyclic
    shift.
    """
    length = waveform.frame_length
    frames = whole_frames(samples, length)
    finite = np.isfinite(frames).all(axis=1)
    if not finite.any():
        return None
    # Samples of another type read as floats may have any size.
    with np.errstate(over="ignore", invalid="ignore"):
        mean = frames[finite].mean(axis=0)
    match = np.abs(np.fft.ifft(np.fft.fft(mean) * np.fft.fft(waveform.frame()).conj()))
    best = int(np.argmax(match))
    if not match[best] > 0:
        return None
    # Partial overlaps match as well: only shifts without any overlap measure the noise.
    quiet = _quiet(match, best, waveform.preamble_length)
    if quiet is not None and match[best] < _CLEAR * np.sqrt(np.mean(quiet**2)):
        return None
    return (best - MARGIN) % length


def _quiet(match: Array, best: int, preamble: int) -> Array | None:
    """Matches at shifts that do not overlap the preamble, None when the guard is too short."""
    length = len(match)
    distance = np.minimum((np.arange(length) - best) % length, (best - np.arange(length)) % length)
    quiet = match[distance > preamble + _ECHOES]
    return quiet if len(quiet) >= _LEAST_QUIET else None


def has_quiet_samples(waveform: Waveform) -> bool:
    """Whether the guard is long enough to tell a preamble from noise in the mean frame.

    Returns bool: False where :func:`find_frame_offset` gives the best offset, whatever it is.
    """
    return waveform.frame_length - 2 * (waveform.preamble_length + _ECHOES) - 1 >= _LEAST_QUIET


def keeps_alignment(offset: int, waveform: Waveform) -> bool:
    """Whether frames cut from sample 0 contain their averaged repetitions.

    Returns bool: True where the delay fits into the repetitions that are dropped.

    Parameters
    ----------
    offset : int
        Sample at which the first frame begins.
    waveform : Waveform
        As it was sent.
    """
    late = (offset + MARGIN) % waveform.frame_length
    return late <= waveform.first_averaged - MARGIN


def frame_offset_in(samples: Array, waveform: Waveform) -> int:
    """Samples before the first frame of a recording.

    Returns int: 0 where frames cut from sample 0 contain their preambles, and where no preamble is
    found.

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        The recording's first samples, :func:`searched_samples` if it is that long.
    waveform : Waveform
        As it was sent.
    """
    offset = find_frame_offset(samples, waveform)
    return 0 if offset is None or keeps_alignment(offset, waveform) else offset


def describe_frames(waveform: Waveform) -> str:
    """Name the frames that are searched, for messages that say that there are none."""
    rate = f"{waveform.sample_rate_hz / 1e6:g} Msps"
    return f"waveform {waveform.name!r}, {waveform.frame_length} samples per frame at {rate}"
