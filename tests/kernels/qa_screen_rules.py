# SPDX-License-Identifier: GPL-3.0-or-later
"""Which differences between the repetitions of a snapshot are taken for interference."""

import numpy as np
import pytest
from gnuradio.wiforce.wiforce_kernels import interference_screen
from plain import normal

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


@pytest.mark.parametrize(
    ("length", "step", "last"), [(40, 0, 0), (125, 0, 0), (125, 0.05, 0), (40, 0, np.nan)]
)
def test_bursts_are_marked_where_they_are_and_edges_of_a_tag_are_not(length, step, last):
    """Also in short groups, with noise below the converter's steps, and beside lost samples."""
    rng, screen = np.random.default_rng(3), interference_screen(length, SYMBOL)
    room, tag = 3 * normal(rng, SYMBOL), 0.1 * normal(rng, SYMBOL)
    hit, found, apart = 0, 0, 0
    for _ in range(12):
        hits = np.append(rng.random(length - 1) < 0.05, False)
        edges = np.arange(4) > rng.integers(0, 8, (length, 1))  # behind a repetition, or none
        on = (np.arange(length)[:, None] // 3 % 2 > 0) ^ edges
        x = room + on[..., None] * tag
        x = x + np.where(hits, 0.1, 0.01)[:, None, None] * normal(rng, length, 4, SYMBOL)
        if step:
            x = step * np.round(x / step)
        x[-1] += last
        steps = np.diff(x.view(float), axis=1) ** 2
        noise = np.stack([steps.min(axis=1).mean(axis=1), steps.max(axis=1).mean(axis=1)], axis=1)
        marks = screen.examine(np.ones(length, bool), x.mean(axis=1), noise)
        around = np.pad(hits, 1)
        hit, found = hit + hits.sum(), found + (hits & marks).sum()
        # An edge beside a burst may be a part of it.
        apart += (marks & ~(around[:-2] | hits | around[2:])).sum()
    assert hit > 15 and found >= hit - 1  # of the first group
    assert apart == 0
