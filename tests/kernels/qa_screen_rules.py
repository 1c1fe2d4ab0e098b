# SPDX-License-Identifier: GPL-3.0-or-later
"""Which differences between the repetitions of a snapshot are taken for interference."""

import numpy as np
import pytest
from gnuradio.wiforce.wiforce_kernels import interference_screen

LENGTH, SYMBOL = 125, 64
NOISE = (0.11, 1.0)  # smallest and largest difference of noise
RISING = np.stack([np.full(LENGTH, 0.11), np.linspace(1.0, 2.0, LENGTH)], axis=1)


def marked(noise, others, tag=0.0):
    """Rows that are marked of a group of some noise, in which a few snapshots are others.

    ``tag``: difference of the snapshots between two states of a tag.
    """
    values = np.tile(noise, (LENGTH // len(noise), 1)).astype(np.float32)
    for row, value in others.items():
        values[row] = value
    folded = np.ones((LENGTH, SYMBOL), np.complex64)
    folded[::2] += tag
    marks = interference_screen(LENGTH, SYMBOL).examine(np.ones(LENGTH, bool), folded, values)
    return np.flatnonzero(marks).tolist()


@pytest.mark.parametrize(
    ("noise", "others", "tag", "expected"),
    [
        pytest.param([NOISE], {40: (0.5, 1.0), 80: (0.6, 1.0)}, 0, [80], id="whole frame"),
        pytest.param([NOISE], {40: (0.11, 2.1), 80: (0.11, 2.3)}, 0, [80], id="part of a frame"),
        pytest.param([NOISE], {40: (0.6, 8.0), 80: (0.6, 10.0)}, 4, [40], id="edges of two tags"),
        pytest.param(RISING, {80: (0.11, 4.0)}, 0, [], id="noise that varies"),
        pytest.param([(0, 1.0)], {40: (0.07, 1.0)}, 0, [], id="noise below the steps"),
        pytest.param([(0, 0), NOISE, NOISE, NOISE, NOISE], {}, 0, [], id="dead air"),
    ],
)
def test_screen_marks_differences_beyond_noise_and_tags(noise, others, tag, expected):
    """What is marked is lost; what is not is read as the tag."""
    assert marked(noise, others, tag) == expected
