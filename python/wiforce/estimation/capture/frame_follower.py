# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of a transmitter whose sample clock is not the receiver's: cut where they begin."""

from __future__ import annotations

import math

import numpy as np

from ..groups import Array

# Frames that are cut together, and every how many of them timing is measured with.
_BLOCK, _EVERY = 64, 4
# Gains of the second-order loop for the frames' position and period. Its settling time, some ten
# blocks, is short against the 72 samples that 50 ppm are in 2000 frames of 720 samples.
_POSITION_GAIN, _PERIOD_GAIN = 0.4, 0.05
# A larger offset is no drift: 100 ppm in a block of 720-sample frames are 4.6 samples.
_JUMP, _SAME_JUMP = 8.0, 2.0
_COHERENT = 0.5
_ADAPTATION = 0.01


class FrameFollower:
    """Cuts a stream into frames that keep their timing, whatever the period of the transmitter.

    Where the transmitter is faster than the receiver, frames overlap by a sample now and then;
    where it is slower, a sample between two frames is left out. What remains of the delay, half a
    sample, is common to both antennas and cancels in their ratio.

    Parameters
    ----------
    frame_length : int
        Samples per frame, as it was sent. The stream begins with a frame.

    Attributes
    ----------
    period : float
        Samples from one frame to the next.
    lost : int
        Frames that were lost in the gaps that are known.
    moved : int
        Times that the frame timing shifted without a known gap.

    Notes
    -----
    Timing is measured by the product of neighbouring bins of a frame's spectrum, summed over bins
    and frames. A delay of d samples rotates it by -2 pi d / L; the common phase of a frame, which a
    free-running oscillator makes random, cancels.
    """

    def __init__(self, frame_length: int) -> None:
        self._length = frame_length
        self.period = float(frame_length)
        self.lost = self.moved = 0
        self._held: Array | None = None
        self._at = 0  # position of the first sample that is held
        self._next = 0.0  # position of the next frame
        self._template: Array | None = None
        self._jump: float | None = None

    def take(self, items: Array) -> Array:
        """Take the next samples.

        Returns ndarray of int16, shape (m L, 2 A): whole frames.

        Parameters
        ----------
        items : ndarray of int16, shape (n, 2 A)
            I and Q of A antennas; timing is that of the first one.
        """
        held = items if self._held is None else np.concatenate([self._held, items])
        frames = []
        while (found := self._cut(held, _BLOCK)) is not None:
            frames.append(found)
            self._follow(found[::_EVERY, :, :2])
            passed = max(math.floor(self._next) - 1 - self._at, 0)
            held = held[passed:]
            self._at += passed
        self._held = held.copy()
        return self._joined(frames, items.shape[1])

    def lose(self, samples: int, width: int = 2) -> Array:
        """Samples were lost behind those taken so far.

        Returns ndarray of int16, shape (m L, 2 A): the whole frames before the gap.

        Parameters
        ----------
        width : int
            Columns of the items.
        """
        frames = []
        held = np.empty((0, width), np.int16) if self._held is None else self._held
        while (found := self._cut(held, 1)) is not None:
            frames.append(found)
        self._at += len(held) + samples
        self._held = None
        missed = max(math.ceil((self._at - self._next) / self.period), 0)
        self._next += missed * self.period
        self.lost += missed
        self._jump = None
        return self._joined(frames, width)

    def _cut(self, held: Array, count: int) -> Array | None:
        """The next frames, shape (count, L, 2 A); None where they are not there yet."""
        positions = self._next + self.period * np.arange(count)
        starts = np.rint(positions).astype(int) - self._at
        if starts[-1] + self._length > len(held):
            return None
        self._next += count * self.period
        starts = np.maximum(starts, 0)
        if starts[-1] - starts[0] == (count - 1) * self._length:  # they follow each other
            return held[starts[0] : starts[-1] + self._length].reshape(count, self._length, -1)
        return held[starts[:, None] + np.arange(self._length)]

    def _joined(self, frames: list[Array], width: int) -> Array:
        if not frames:
            return np.empty((0, width), np.int16)
        return np.concatenate([each.reshape(-1, width) for each in frames])

    def _follow(self, frames: Array) -> None:
        product = _neighbours(frames)
        energy = float(np.vdot(product, product).real)
        if not energy > 0:
            return
        if self._template is None:
            self._template = product
            return
        template = self._template
        match = np.vdot(template, product)
        if abs(match) < _COHERENT * math.sqrt(energy * float(np.vdot(template, template).real)):
            return
        turn = 2 * math.pi / self._length
        late = -float(np.angle(match)) / turn
        if abs(late) > _JUMP:
            if self._jump is None or abs(late - self._jump) > _SAME_JUMP:
                self._jump = late
                return
            self._next += late
            self.moved += 1
            self._jump = None
            return
        self._jump = None
        self._next += _POSITION_GAIN * late
        self.period += _PERIOD_GAIN * late / _BLOCK
        self._template = template + _ADAPTATION * (product * np.exp(1j * turn * late) - template)


def _neighbours(frames: Array) -> Array:
    """Products of neighbouring bins, summed over frames of shape (n, L, 2)."""
    values = frames[..., 0] + 1j * frames[..., 1]
    values -= values.mean(axis=1, keepdims=True)
    spectra = np.fft.fft(values)
    return np.sum(spectra[:, 1:] * spectra[:, :-1].conj(), axis=0)
