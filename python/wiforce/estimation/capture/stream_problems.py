# SPDX-License-Identifier: GPL-3.0-or-later
"""What keeps a stream of samples from being read, in one sentence that names the cause."""

from __future__ import annotations

import math

import numpy as np

from ...errors import InputError
from ...io.capture.recordings import Capture
from ...io.capture.samples import usual_share
from ...signal.waveform import Waveform
from ..groups import Array
from .frame import (
    MARGIN,
    describe_frames,
    find_frame_offset,
    has_quiet_samples,
    keeps_alignment,
    searched_samples,
    whole_frames,
)
from .frame_period import SEARCHED_SAMPLES, find_frame_period, samples_needed
from .recorded_frames import other_frames, require_frames

# Full scale of both I and Q is 3.01 dBFS. The quantisation noise of 16 bits, 2 (2^-15)^2 / 12, is
# -98 dBFS, and folding lowers it by 6 dB; what is weaker was not sent by a converter.
_MOST_DBFS, _LEAST_DBFS = 3.1, -105.0
# Share of floats of a usual size below which they are integers that are read as floats: these have
# exponents that are spread evenly, of which a fifth is usual; damaged files of floats have 95 %.
_USUAL_SHARE = 0.5
# Part of the snapshots' power that is the same in all of them, times their number: 1 for noise with
# a standard deviation of 1/8 over a symbol's 64 samples.
_COHERENT, _FEWEST = 3.0, 16
# Above 20 the noise takes at most 5 % of the power from the paths. In simulated rooms a quarter of
# the symbol holds 97 %, where frames have another waveform or length at most 50 %.
_CLEAR, _SHORT_PATHS = 20.0, 0.7


def level_problem(samples: Array) -> str:
    """Improbable values of samples, or of their means.

    Parameters
    ----------
    samples : ndarray of complex, any shape
        Full scale is 1.

    Returns
    -------
    str
        Empty for usual values.

    Examples
    --------
    >>> level_problem(np.full(10, np.nan + 0j))
    'all samples are NaN or infinite; check the block that makes them'
    >>> level_problem(np.full(10, 0.1 + 0.1j))
    ''
    """
    samples = np.ascontiguousarray(samples, np.complex64).ravel()
    if not len(samples):
        return ""
    finite = samples[np.isfinite(samples)]
    if not len(finite):
        return "all samples are NaN or infinite; check the block that makes them"
    if usual_share(samples.view(np.float32)) < _USUAL_SHARE:
        return (
            "the samples have values that 16-bit integers have when they are read as floats; "
            "check the type of the source, and the input type"
        )
    power = float(np.mean(np.abs(finite.astype(complex)) ** 2))
    if not power:
        return "all samples are 0; check that the source delivers a signal"
    level = 10 * math.log10(power)
    if level > _MOST_DBFS:
        return (
            f"the samples have {level:.0f} dBFS, full scale being 1; divide integers of 16 bits "
            "by 32768, or use the type sc16"
        )
    if level < _LEAST_DBFS:
        return (
            f"the samples have {level:.0f} dBFS, less than the noise of a converter; check the "
            "scale and the type of the source"
        )
    return ""


def snapshots_problem(folded: Array, waveform: Waveform) -> str:
    """Why the snapshots of a group cannot be those of frames.

    Parameters
    ----------
    folded : ndarray of complex, shape (N, symbol_length)
        Folded frames that were received.
    waveform : Waveform
        As it was sent.

    Returns
    -------
    str
        Empty where they have a part in common, as frames by static paths have, and this part is the
        waveform by paths that are shorter than a quarter of its symbol.

    Examples
    --------
    >>> from gnuradio.wiforce.signal.waveform import sounding_waveform
    >>> waveform = sounding_waveform()
    >>> noise = np.random.default_rng(1).standard_normal((200, 64, 2)) @ np.array([1, 1j])
    >>> snapshots_problem(0.01 * noise, waveform)[:36]
    'no frames of the scene are received '
    >>> snapshots_problem(0.01 * (waveform.symbol + noise), waveform)
    ''
    """
    if len(folded) < _FEWEST:
        return ""
    mean = folded.mean(axis=0)
    power = float(np.mean(np.abs(folded) ** 2))
    coherent = float(np.mean(np.abs(mean) ** 2)) / max(power, 1e-30) * len(folded)
    if coherent < _COHERENT:
        return _no_frames(waveform)
    if coherent > _CLEAR and _short_paths(mean, waveform) < _SHORT_PATHS:
        return (
            f"frames are received, but not those of the scene ({describe_frames(waveform)}); check "
            "its waveform, frame length and sample rate"
        )
    return ""


def _short_paths(mean: Array, waveform: Waveform) -> float:
    """Share of the channel's power within the quarter of a symbol that holds most of it."""
    channel = np.zeros(waveform.symbol_length, complex)
    channel[waveform.bins] = (np.fft.fft(mean) * waveform.equalizer())[waveform.bins]
    paths = np.abs(np.fft.ifft(channel)) ** 2
    quarter = len(paths) // 4
    sums = np.cumsum(np.concatenate([paths, paths[:quarter]]))
    return float(np.max(sums[quarter:] - sums[:-quarter]) / max(paths.sum(), 1e-30))


def frame_problem(mean_frame: Array, waveform: Waveform, frame_offset: int) -> str:
    """Where frames begin that do not begin where they are expected.

    Parameters
    ----------
    mean_frame : ndarray of complex, shape (frame_length,)
        Mean of many frames, as cut; empty where it is not known.
    waveform : Waveform
        As it was sent.
    frame_offset : int
        Sample of the stream at which the first of these frames was taken to begin.

    Returns
    -------
    str

    Examples
    --------
    >>> from gnuradio.wiforce.signal.waveform import sounding_waveform
    >>> waveform = sounding_waveform()
    >>> frame_problem(np.roll(waveform.frame(), 200), waveform, 0)[:49]
    'frames begin at sample 200 and every 720 from the'
    """
    if not len(mean_frame) or not has_quiet_samples(waveform):
        return ""
    offset = find_frame_offset(mean_frame, waveform)
    length = waveform.frame_length
    if offset is None or keeps_alignment(offset, waveform):
        return ""
    begin = (frame_offset + offset + MARGIN) % length
    return (
        f"frames begin at sample {begin} and every {length} from there, not at sample "
        f"{frame_offset}; set the frame offset, or put a Frame Alignment before the reader"
    )


def search_problem(samples: Array, waveform: Waveform) -> str:
    """Why no frames are found in samples.

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        In which :func:`.frame.find_frame_offset` found none.
    waveform : Waveform
        That was searched.

    Returns
    -------
    str

    Examples
    --------
    >>> from gnuradio.wiforce.signal.waveform import sounding_waveform
    >>> sent = np.tile(sounding_waveform(frame_length=1000).frame(), 40)
    >>> search_problem(0.1 * sent, sounding_waveform())
    'frames repeat every 1000 samples, but sounding.frame_length is 720'
    """
    problem = level_problem(samples)
    if problem:
        return problem
    found = find_frame_period(samples, waveform)
    problem = other_frames(samples[:SEARCHED_SAMPLES], waveform, found.likeness)
    if not problem and found.samples is not None and not found.agrees:
        return (
            f"frames repeat every {found.samples:.6g} samples, but sounding.frame_length is "
            f"{waveform.frame_length}"
        )
    return problem or _no_frames(waveform)


def capture_problem(recording: Capture, waveform: Waveform, frame_offset: int) -> str:
    """Why a recording cannot be read from a sample on.

    Parameters
    ----------
    recording : Capture
    waveform : Waveform
        As it was sent.
    frame_offset : int
        Sample at which its first frame is taken to begin.

    Returns
    -------
    str
        With the file's name; empty where it can be read.

    Examples
    --------
    >>> from gnuradio.wiforce.io.capture import open_capture
    >>> from gnuradio.wiforce.signal.waveform import sounding_waveform
    >>> np.tile(0.1 * sounding_waveform().frame(), 200).astype(np.complex64).tofile("sent.cf32")
    >>> sent = open_capture("sent.cf32", "cf32_le")
    >>> capture_problem(sent, sounding_waveform(), 0)
    ''
    >>> capture_problem(sent, sounding_waveform(), 300)[:46]
    'sent.cf32: frames begin at sample 0 and every '
    """
    samples = recording.read_span(frame_offset, samples_needed(waveform.frame_length))
    problem = level_problem(samples)
    if problem:
        return f"{recording.path}: {problem}"
    try:
        place = require_frames(recording, waveform)
    except InputError as error:
        return str(error)
    place += (frame_offset - place) % waveform.frame_length
    frames = whole_frames(
        recording.read_span(place, searched_samples(waveform)), waveform.frame_length
    )
    frames = frames[np.isfinite(frames).all(axis=1)]
    if not len(frames):
        return ""
    problem = frame_problem(frames.mean(axis=0), waveform, frame_offset)
    return problem and f"{recording.path}: {problem}"


def _no_frames(waveform: Waveform) -> str:
    return (
        f"no frames of the scene are received ({describe_frames(waveform)}), only noise or another "
        "signal; check the transmitter, the carrier, the sample rate, and the type of the samples"
    )
