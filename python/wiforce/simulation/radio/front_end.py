# SPDX-License-Identifier: GPL-3.0-or-later
"""The analogue parts of transmitter and receiver: imbalance of I and Q, DC, compression, ripple."""

from typing import TYPE_CHECKING

import numpy as np

from ..random_sources import Seeds
from ..streams import Ramp

if TYPE_CHECKING:
    from ...scene.effects import FrontEnd, Ripple


def image_gains(gain_db: float, phase_deg: float) -> tuple[complex, complex]:
    """mu and nu of y = mu x + nu conj(x) for a mixer whose I and Q differ.

    Parameters
    ----------
    gain_db : float
        Of Q relative to I.
    phase_deg : float
        Deviation of their angle from 90 degrees.

    Notes
    -----
    I stays as it is, and Q becomes g (Q cos phi + I sin phi), so that
    mu = (1 + g exp(j phi)) / 2 and nu = (1 - g exp(-j phi)) / 2. See M. Valkama, M. Renfors,
    V. Koivunen, "Advanced methods for I/Q imbalance compensation in communication receivers",
    IEEE Trans. Signal Processing 49 (2001).
    """
    rotated = 10 ** (gain_db / 20) * np.exp(1j * np.deg2rad(phase_deg))
    return complex(1 + rotated) / 2, complex(1 - np.conj(rotated)) / 2


class AnalogueFrontEnd:
    """Mixers of transmitter and receiver, and the receiver's amplifier.

    Parameters
    ----------
    stated : FrontEnd
        The keys of the scene.
    peak : float
        Peak of the received signal, to which compression and DC offset refer.

    Notes
    -----
    The amplifier comes before the mixer: x (1 - c min(|x|^2 / peak^2, 1 / (3 c))), the third-order
    polynomial up to where its slope would be negative. Then follow the mixer's image and the DC
    offset.
    """

    def __init__(self, stated: "FrontEnd", peak: float, seeds: Seeds) -> None:
        self._sent = image_gains(stated.transmitter_gain_db, stated.transmitter_phase_deg)
        self._received = image_gains(stated.receiver_gain_db, stated.receiver_phase_deg)
        self._curvature = stated.compression / peak**2
        angle = 2 * np.pi * seeds.generator().random()
        self._dc = np.complex64(stated.dc_offset * peak * np.exp(1j * angle))

    def transmit(self, samples: np.ndarray) -> np.ndarray:
        """What the transmitter sends instead of some samples.

        Returns ndarray of complex64, shape (n,).

        Parameters
        ----------
        samples : ndarray of complex64, shape (n,)
        """
        return _with_image(samples, *self._sent)

    def receive(self, samples: np.ndarray) -> None:
        """Apply the receiver's amplifier and mixer.

        Parameters
        ----------
        samples : ndarray of complex64, shape (n,)
            Changed in place.
        """
        if self._curvature:
            power = samples.real**2 + samples.imag**2
            lost = np.minimum(np.float32(self._curvature) * power, np.float32(1 / 3))
            samples *= 1 - lost
        samples[:] = _with_image(samples, *self._received)
        if self._dc:
            samples += self._dc


def _with_image(samples: np.ndarray, mu: complex, nu: complex) -> np.ndarray:
    if nu == 0:
        return samples
    return np.complex64(mu) * samples + np.complex64(nu) * samples.conj()


class GainRipple:
    """Amplitude modulation 1 + a cos(2 pi f t + phi) of all that is received.

    Parameters
    ----------
    stated : Ripple
        The keys of the scene.
    ramp : Ramp
        Knots between which the gain is interpolated.
    """

    def __init__(self, stated: "Ripple", ramp: Ramp, seeds: Seeds) -> None:
        self._amplitude, self._hz, self._ramp = stated.percent / 100, stated.hz, ramp
        self._start = seeds.generator().random()

    def modulate(self, first_sample: int, samples: np.ndarray) -> None:
        """Modulate samples.

        Parameters
        ----------
        first_sample : int
            Index of the first since time 0.
        samples : ndarray of complex64, shape (n,)
            Changed in place.
        """
        times = self._ramp.knots(first_sample, len(samples))
        gain = 1 + self._amplitude * np.cos(2 * np.pi * (self._start + self._hz * times))
        samples *= self._ramp.interpolate(gain, first_sample, len(samples))
