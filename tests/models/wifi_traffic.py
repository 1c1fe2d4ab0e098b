# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of 802.11n devices as a receiver at 12.5 Msps gets them; shares no code with the product.

Measured in three captures of an 802.11n link at 5.2 GHz by a USRP N210 (1.2, 2.5 and 0.8 ms at
20 Msps; test inputs of openofdm, Apache-2.0; MCS 2, 3 and 7): two stations, one 11.5 dB weaker
than the other, alternate without a rest. The stronger one sends data for 58, 97, 125 or 197 us,
the weaker one answers after 2 us for 20 to 25 us and sends data for 55 to 75 us or 200 us after
15 us, and the stronger one acknowledges for 33.6 us after 15 us. The next exchange begins 1 to
25 us later. The spectrum is that of 56 subcarriers, 312.5 kHz apart; on 12.5 MHz in its middle it
is flat within 5 dB. The largest thousandth of the samples lies 10 dB above the mean.
"""

import numpy as np

RATE_HZ = 12.5e6
WEAKER_DB = 11.5
STRONG_DATA_US, ANSWER_US = (57.6, 97.5, 125.0, 197.0), (19.0, 25.0)
WEAK_DATA_US, ACKNOWLEDGE_US = (55.0, 66.0, 75.0, 200.0), 33.6
SHORT_GAP_US, SIFS_US, NEXT_US = 2.0, 15.0, (1.0, 25.0)
# A symbol at this rate: 3.2 us, of which 40 subcarriers are in the band, and a guard of 0.8 us.
SYMBOL, GUARD = 40, 10


def exchange(rng):
    """Frames of one exchange: (gap before it in us, length in us, level in dB) each."""
    return (
        (rng.uniform(*NEXT_US), rng.choice(STRONG_DATA_US), 0.0),
        (SHORT_GAP_US, rng.uniform(*ANSWER_US), -WEAKER_DB),
        (SIFS_US, rng.choice(WEAK_DATA_US), -WEAKER_DB),
        (SIFS_US, ACKNOWLEDGE_US, 0.0),
    )


def frame(rng, length):
    """OFDM symbols of random QPSK through a channel of two paths; complex, unit mean power."""
    symbols = -(-length // (SYMBOL + GUARD))
    spectrum = rng.choice([1, 1j, -1, -1j], (symbols, SYMBOL))
    spectrum = spectrum * (1 + 0.3 * np.exp(2j * np.pi * (np.arange(SYMBOL) / 20 + rng.random())))
    useful = np.fft.ifft(spectrum, axis=1)
    sent = np.hstack([useful[:, -GUARD:], useful]).ravel()[:length]
    return sent / np.sqrt(np.mean(np.abs(sent) ** 2))


def wifi_traffic(count, share, seed):
    """What is received of the link while it is busy for a share of the time.

    Returns complex, shape (count,): the stronger station has a mean power of 1.
    """
    rng = np.random.default_rng(seed)
    received, at = np.zeros(count, complex), 0
    while at < count:
        begun = at
        for gap_us, length_us, level_db in exchange(rng):
            at += round(gap_us * 1e-6 * RATE_HZ)
            sent = frame(rng, round(length_us * 1e-6 * RATE_HZ)) * 10 ** (level_db / 20)
            received[at : at + len(sent)] = sent[: max(0, count - at)]
            at += len(sent)
        # An exchange is on the air for nine tenths of its time.
        at += int(rng.exponential((at - begun) * (0.9 / share - 1)))
    return received
