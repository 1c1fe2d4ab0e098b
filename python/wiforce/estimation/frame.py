# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the frames of a stream begin."""

import numpy as np

# The strongest path is put so many samples after the frame's start: earlier, weaker paths still
# fall behind it, and echoes up to 56 samples later stay inside the repetition that is dropped.
MARGIN = 8
# Averaging so many frames raises the preamble by 33 dB over what changes from frame to frame.
SEARCHED_FRAMES = 2000
# Best match over the typical one, in standard deviations, that counts as a preamble.
_CLEAR = 12.0


def find_frame_offset(samples, waveform):
    """Sample at which the first frame of a stream begins.

    Frames are averaged, so that what stands still adds up, and matched with the preamble at every
    cyclic shift.

    Parameters
    ----------
    samples : ndarray of complex, shape (n,)
        At least one frame from the start of the stream; a thousand frames or more are better.
    waveform : Waveform

    Returns
    -------
    int or None
        0 <= offset < frame_length; ``MARGIN`` samples before the strongest path. None when no
        preamble stands out.
    """
    length = waveform.frame_length
    frames = samples[: len(samples) // length * length].reshape(-1, length)
    finite = np.isfinite(frames).all(axis=1)
    if not finite.any():
        return None
    mean = frames[finite].mean(axis=0)
    match = np.abs(np.fft.ifft(np.fft.fft(mean) * np.fft.fft(waveform.frame()).conj()))
    best = int(np.argmax(match))
    if not match[best] > 0:
        return None
    # Partial overlaps match as well: only shifts that see none of the preamble tell the noise.
    quiet = _quiet(match, best)
    if quiet is not None and match[best] < _CLEAR * np.sqrt(np.mean(quiet**2)):
        return None
    return (best - MARGIN) % length


def _quiet(match, best):
    """Matches at shifts that overlap no preamble, None when the guard leaves none."""
    length = len(match)
    distance = np.minimum((np.arange(length) - best) % length, (best - np.arange(length)) % length)
    quiet = match[distance > 330]
    return quiet if len(quiet) >= 8 else None


def keeps_alignment(offset, waveform):
    """Whether frames taken from sample 0 hold their preamble when they begin at ``offset``."""
    late = (offset + MARGIN) % waveform.frame_length
    return late <= waveform.first_averaged - MARGIN


def frame_offset_in(samples, waveform):
    """Samples before the first frame of a recording that begins with these samples.

    0 where frames taken from sample 0 on hold their preambles, and where no preamble stands out.
    """
    offset = find_frame_offset(samples, waveform)
    return 0 if offset is None or keeps_alignment(offset, waveform) else offset
